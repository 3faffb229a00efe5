"""Record what a program does to the disk, and show what is left after a power cut at any moment of it."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import pytest


@dataclass
class Log:
    """Calls of the operating system that changed the folder `root`, and marks that the test put between them."""

    root: Path
    calls: list[tuple] = field(default_factory=list)

    def mark(self, what: object) -> None:
        self.calls.append(("mark", what))


@contextmanager
def recording(root: Path) -> Iterator[Log]:
    """Record every open, write, truncate, fsync, mkdir, rename and unlink below `root`."""
    log = Log(root)
    names: dict[int, str] = {}
    real = {
        name: getattr(os, name)
        for name in ("open", "write", "ftruncate", "fsync", "close", "mkdir", "rename", "unlink")
    }

    def inside(path: object) -> bool:
        return Path(str(path)).is_relative_to(root)

    def open_(path, flags, mode=0o777, **more):
        handle = real["open"](path, flags, mode, **more)
        if inside(path):
            names[handle] = str(path)
            if flags & os.O_CREAT:
                log.calls.append(("create", str(path), bool(flags & os.O_TRUNC)))
        return handle

    def write(handle, data):
        count = real["write"](handle, data)
        if handle in names:
            log.calls.append(("write", names[handle], bytes(data)[:count]))
        return count

    def ftruncate(handle, size):
        real["ftruncate"](handle, size)
        if handle in names:
            log.calls.append(("truncate", names[handle], size))

    def fsync(handle):
        real["fsync"](handle)
        if handle in names:
            log.calls.append(("fsync", names[handle]))

    def close(handle):
        names.pop(handle, None)
        real["close"](handle)

    def mkdir(path, mode=0o777, **more):
        real["mkdir"](path, mode, **more)
        if inside(path):
            log.calls.append(("mkdir", str(path)))

    def rename(old, new, **more):
        real["rename"](old, new, **more)
        if inside(new):
            log.calls.append(("rename", str(old), str(new)))

    def unlink(path, **more):
        real["unlink"](path, **more)
        if inside(path):
            log.calls.append(("unlink", str(path)))

    with pytest.MonkeyPatch.context() as patch:
        for fake in (open_, write, ftruncate, fsync, close, mkdir, rename, unlink):
            patch.setattr(os, fake.__name__.rstrip("_"), fake)
        yield log


class Node:
    """A file or a folder, as the program sees it (`now`) and as the disk has it (`kept`)."""

    def __init__(self, folder: bool) -> None:
        self.now = {} if folder else b""
        self.kept = {} if folder else b""


def after_power_cut(log: Log, calls: int, target: Path, torn: int = 0) -> None:
    """Make at `target` what is left of `log.root` when the power goes after that many calls.

    Contents that were not fsynced and names whose folder was not fsynced are gone. With `torn`, that many bytes of what
    was written to the end of a file but not fsynced are there after all.
    """
    top = Node(folder=True)

    def find(path: str) -> Node:
        node = top
        for part in Path(path).relative_to(log.root).parts:
            node = node.now[part]
        return node

    for name, *what in log.calls[:calls]:
        if name == "mark":
            continue
        path = what[0]
        parent, leaf = find(str(Path(path).parent)) if path != str(log.root) else None, Path(path).name
        if name == "mkdir":
            parent.now[leaf] = Node(folder=True)
        elif name == "create":
            node = parent.now.setdefault(leaf, Node(folder=False))
            if what[1]:
                node.now = b""
        elif name == "write":
            find(path).now += what[1]
        elif name == "truncate":
            find(path).now = find(path).now[: what[1]]
        elif name == "fsync":
            node = find(path)
            node.kept = dict(node.now) if isinstance(node.now, dict) else node.now
        elif name == "rename":
            find(str(Path(what[1]).parent)).now[Path(what[1]).name] = parent.now.pop(leaf)
        elif name == "unlink":
            parent.now.pop(leaf)

    def put(node: Node, path: Path) -> None:
        if isinstance(node.kept, dict):
            path.mkdir()
            for leaf, child in node.kept.items():
                put(child, path / leaf)
        else:
            more = node.now[len(node.kept) :][:torn] if node.now.startswith(node.kept) else b""
            path.write_bytes(node.kept + more)

    put(top, target)


@contextmanager
def failing(root: Path, first: int, error: int, lasting: bool) -> Iterator[list[int]]:
    """Let the call with number `first` that changes the folder `root` fail, and with `lasting` all after it.

    A failing write has written half. What is given counts the calls so far.
    """
    names: dict[int, str] = {}
    count = [0]
    real = {name: getattr(os, name) for name in ("open", "write", "ftruncate", "fsync", "mkdir", "rename", "unlink")}

    def inside(path: object) -> bool:
        return Path(str(path)).is_relative_to(root)

    def due() -> bool:
        count[0] += 1
        return count[0] == first or (lasting and count[0] > first)

    def refuse() -> None:
        raise OSError(error, os.strerror(error))

    def open_(path, flags, mode=0o777, **more):
        if inside(path) and flags & (os.O_WRONLY | os.O_RDWR) and due():
            refuse()
        handle = real["open"](path, flags, mode, **more)
        if inside(path):
            names[handle] = str(path)
        else:
            names.pop(handle, None)
        return handle

    def write(handle, data):
        if handle in names and due():
            real["write"](handle, bytes(data)[: len(data) // 2])
            refuse()
        return real["write"](handle, data)

    def on_handle(name):
        def call(handle, *more):
            if handle in names and due():
                refuse()
            return real[name](handle, *more)

        return call

    def on_path(name):
        def call(path, *more, **others):
            if inside(path) and due():
                refuse()
            return real[name](path, *more, **others)

        return call

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "open", open_)
        patch.setattr(os, "write", write)
        for name in ("ftruncate", "fsync"):
            patch.setattr(os, name, on_handle(name))
        for name in ("mkdir", "rename", "unlink"):
            patch.setattr(os, name, on_path(name))
        yield count
