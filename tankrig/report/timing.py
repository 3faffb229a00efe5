"""Where a run's time went: how long each step and each fit took."""

from collections.abc import Sequence
from dataclasses import dataclass

from tankrig.run.journal import Event
from tankrig.run.reading import Run

WORDS = {"dose": "dose", "wait": "wait", "capture": "capture", "note:": "note"}


@dataclass(frozen=True)
class Span:
    """Something that took time; `kind` is "dose", "wait", "capture", "note" or "fit"."""

    label: str
    kind: str
    begin_s: float
    seconds: float


def spans_of(run: Run) -> list[Span]:
    """Steps and fits, in the order in which they ended; times count from the journal's first line.

    A resumed run has pauses of any length in it, and on another boot another clock: the steps of each session follow
    the session before at once.
    """
    spans: list[Span] = []
    begun: Event | None = None
    zero_ns, shift_s, latest_s = 0, 0.0, 0.0
    ended = False
    for event in run.journal:
        ended = event.kind == "end" or (ended and event.kind != "session")
        if ended and event.kind == "fit":
            continue  # made anew, any time later
        if event.kind == "session":
            zero_ns, shift_s = event.moment.mono_ns, latest_s
        now_s = (event.moment.mono_ns - zero_ns) / 1e9 + shift_s
        latest_s = max(latest_s, now_s)
        if event.kind == "step" and event["state"] == "begun":
            begun, begun_s = event, now_s
        elif event.kind == "step" and begun is not None:
            label = str(begun["label"])
            spans.append(Span(label, _kind(label), begun_s, now_s - begun_s))
            begun = None
        elif event.kind == "fit":
            seconds = float(event.get("seconds", 0.0))
            spans.append(Span(f"fit of the {event.get('fit')}", "fit", now_s - seconds, seconds))
    return spans


def totals(spans: Sequence[Span]) -> list[tuple[str, int, float]]:
    """For each kind: how many, and seconds in all."""
    kinds = list(dict.fromkeys(span.kind for span in spans))
    parts = {kind: [span.seconds for span in spans if span.kind == kind] for kind in kinds}
    return [(kind, len(seconds), sum(seconds)) for kind, seconds in parts.items()]


def _kind(label: str) -> str:
    word = label.rpartition(", ")[2].split(" ")[0]
    return WORDS.get(word, "note")
