"""Figures: images of the tank in grey and false colour, fits beside observations, the paper's figures."""
