"""Shared by the block-transform codecs: tables, the 8x8 DCT, the quantizer, planes and color."""
