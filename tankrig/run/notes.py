"""What a person notes of a run after the fact: lines of its journal, the last of which stands in lists of runs."""

from collections.abc import Iterable
from pathlib import Path

from tankrig.errors import StoreError
from tankrig.run.journal import Event

PERSON = "person"
"""Value of the key `by` in a note that a person has written."""
MOST_LETTERS = 1000


def write_note(run: Path, text: str) -> None:
    """Note something of a run that is not being recorded; an empty text takes back what was noted before.

    Earlier notes stay in the journal.

    Parameters
    ----------
    run
        Its folder.
    text
        At most 1000 letters.

    Raises
    ------
    StoreError
        When the text is too long, the run is being recorded, or its journal cannot be written.
    """
    from tankrig.run.writer import RunWriter

    if len(text) > MOST_LETTERS:
        raise StoreError(f"{run}: a note has at most {MOST_LETTERS} letters, and this has {len(text)}; shorten it")
    with RunWriter(run) as writer:
        writer.put("note", text=text, by=PERSON)
        writer.flush()


def person_note(journal: Iterable[Event]) -> str:
    """What a person has noted last; empty where nobody has.

    Examples
    --------
    >>> from tankrig.run.journal import Moment
    >>> said = [{"text": "camera"}, {"text": "bubbles", "by": "person"}, {"text": "resumed"}]
    >>> person_note(Event(number, "note", Moment("", 0, ""), one) for number, one in enumerate(said))
    'bubbles'
    """
    notes = [str(event["text"]) for event in journal if event.kind == "note" and event.get("by") == PERSON]
    return notes[-1] if notes else ""
