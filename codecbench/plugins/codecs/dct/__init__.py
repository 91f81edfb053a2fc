"""What the block-transform codecs share: tables, the 8x8 DCT, the quantiser, planes and colour."""
