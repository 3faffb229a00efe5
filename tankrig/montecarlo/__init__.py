"""Monte Carlo light transport: what the simulated camera sees, and the check of every other model."""

from tankrig.montecarlo.first_order import first_order
from tankrig.montecarlo.simulation import Tally, simulate, simulate_to

__all__ = ["Tally", "first_order", "simulate", "simulate_to"]
