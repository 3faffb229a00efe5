"""Monte Carlo light transport: what the simulated camera sees, and the check of every other model."""
