"""From a matrix file to a plan: which settings of which plugins meet on which sequence."""
