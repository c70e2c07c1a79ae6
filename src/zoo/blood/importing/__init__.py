"""Networks of other programs as studies: openBF's YAML, and tables of vessels."""
