"""How good estimates are: error, scatter, coverage, robustness and starts, measured and written as one page."""
