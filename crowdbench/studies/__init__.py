"""Studies behind the pages of results: comparisons, ablations, pictures, speeds."""
