"""Filling the tank anew: what commands say of it, said with the button of the window that does it."""

from tankrig.dosing.limits import FILL_ANEW

BUTTON = "Filled with fresh water…"
"""On the Doser page."""
WAY = "To the Doser page"
"""On buttons that lead there."""
HERE = f"fill it anew, then press “{BUTTON}” on the Doser page"


def said_here(sentence: str) -> str:
    """The sentence with the window's own remedy, where it asks for fresh water.

    >>> said_here(f"the tank holds 1600 µl already; {FILL_ANEW}")
    'the tank holds 1600 µl already; fill it anew, then press “Filled with fresh water…” on the Doser page'
    """
    return sentence.replace(FILL_ANEW, HERE)


def asks_for_it(sentence: str) -> bool:
    """Whether a sentence of the window says so."""
    return HERE in sentence
