"""Ink that can be accounted for: budgets, a ledger for each tank, and the guard around every doser."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
