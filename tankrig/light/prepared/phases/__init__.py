"""Prepared models of liquids with any phase function: orders 1 and 2 by splines of p, the rest by a few moments."""
