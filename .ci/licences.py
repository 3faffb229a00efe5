"""Lists the licences of all that tankrig installs, and fails where one is of the GPL's kind or nobody knows it.

python .ci/licences.py [EXTRA …]: reads what is installed in the environment that runs it; without EXTRA, all extras
that ./start installs. LGPL is allowed: it asks nothing of the program that uses the library. So is a GPL that a package
offers as one choice of several.
"""

import re
import sys
from collections.abc import Iterator
from importlib.metadata import Distribution, PackageNotFoundError, distribution

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

STARTED_WITH = ("all", "dev", "docs")
"""Extras that ./start installs."""

KNOWN: dict[str, str] = {
    "hdf5plugin": "MIT",  # its README; the filters within are BSD, MIT, Apache and zlib: silx.org/doc/hdf5plugin
    # Its COPYING: the GPL is that of an Emacs mode, which is in the source archive and not in what pip installs.
    "docutils": "BSD-2-Clause AND BSD-3-Clause; public domain",
}
"""Licences that a package's metadata does not say, or says of files that are not installed, looked up by hand: name →
licence, with the source in a comment."""

_GPL = re.compile(r"(?<![A-Za-z])(?:A?GPL|(?:GNU )?(?:Affero )?General Public Licen[cs]e)", re.IGNORECASE)
_LESSER = re.compile(r"LGPL|Lesser General Public|Library General Public", re.IGNORECASE)
_EXCEPTIONS = re.compile(r"with (?:GCC|Classpath|autoconf|LLVM)[\w-]*exception", re.IGNORECASE)


def required(name: str, extras: tuple[str, ...]) -> Iterator[Distribution]:
    """The distribution `name` and all that it needs here, directly or not, each once."""
    waiting, seen = [(name, frozenset(extras))], {}
    while waiting:
        one, asked = waiting.pop()
        key = canonicalize_name(one)
        if asked <= seen.get(key, frozenset()) and key in seen:
            continue
        try:
            found = distribution(one)
        except PackageNotFoundError:
            continue  # an extra that is not installed here
        if key not in seen:
            yield found
        seen[key] = seen.get(key, frozenset()) | asked
        for text in found.requires or ():
            need = Requirement(text)
            if need.marker is None or any(need.marker.evaluate({"extra": extra}) for extra in (*asked, "")):
                waiting.append((need.name, frozenset(need.extras)))


def licence(found: Distribution) -> str:
    """What its metadata says: the SPDX expression, else the classifiers, else the first line of the free text."""
    facts = found.metadata
    if known := KNOWN.get(canonicalize_name(facts["Name"])):
        return known
    if expression := facts.get("License-Expression"):
        return str(expression)
    said = [line.rpartition(" :: ")[2] for line in facts.get_all("Classifier") or () if line.startswith("License ::")]
    said = [word for word in said if word != "OSI Approved"]
    free = str(facts.get("License") or "").strip()
    if free and free != "UNKNOWN":
        said.append(free.splitlines()[0][:80])
    return "; ".join(dict.fromkeys(said))


def is_gpl(words: str) -> bool:
    """Whether a licence is of the GPL's kind, with no other choice.

    >>> [is_gpl(words) for words in ("GPL-3.0-or-later", "GNU General Public License v3 (GPLv3)", "AGPL-3.0-only")]
    [True, True, True]
    >>> [is_gpl(words) for words in ("LGPL-3.0-only", "LGPL-3.0-only OR GPL-2.0-only OR GPL-3.0-only", "BSD-3-Clause")]
    [False, False, False]
    >>> is_gpl("BSD-3-Clause AND GPL-2.0-only"), is_gpl("GPL-3.0-or-later WITH GCC-exception-3.1 AND MIT")
    (True, False)
    """
    parts = re.split(r"\s+AND\s+", _EXCEPTIONS.sub("-exception", words))
    return any(all(_is_gpl(choice) for choice in re.split(r"\s+OR\s+", part)) for part in parts)


def _is_gpl(words: str) -> bool:
    return bool(_GPL.search(_LESSER.sub("", words))) and "exception" not in words.lower()


def main(extras: tuple[str, ...]) -> int:
    """Print the table and what is wrong; 1 if anything is."""
    rows = {
        canonicalize_name(found.metadata["Name"]): (found.version, licence(found))
        for found in required("tankrig", extras)
    }
    width = max(map(len, rows))
    for name, (version, words) in sorted(rows.items()):
        print(f"{name:{width}}  {version:12}  {words or '?'}")
    troubles = [
        f"{name}: is {words}, which a BSD package may not require; remove it"
        for name, (_, words) in rows.items()
        if is_gpl(words)
    ]
    troubles += [
        f"{name}: its metadata says no licence; look it up and list it in KNOWN with the source"
        for name, (_, words) in rows.items()
        if not words
    ]
    print(f"\n{len(rows)} packages")
    for trouble in sorted(troubles):
        print(f"licences: {trouble}", file=sys.stderr)
    return 1 if troubles else 0


if __name__ == "__main__":
    sys.exit(main(tuple(sys.argv[1:]) or STARTED_WITH))
