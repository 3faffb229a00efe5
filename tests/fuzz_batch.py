"""Batches of mutated files, each of one format, read as a user's commands read them; run by `test_wrong_input`.

python tests/fuzz_batch.py FOLDER FORMAT FIRST COUNT [FORMAT FIRST COUNT …]: mutation number n is the same on every
machine. The number under way is kept in FOLDER/at, so that whoever started this knows which one crashed it. Prints one
JSON object for each batch.
"""

import io
import json
import os
import random
import re
import resource
import shutil
import signal
import sys
import traceback
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

import tankrig
from tankrig import TankrigError

TESTS = Path(__file__).parent
DOCS = TESTS.parent / "docs" / "examples"
STORED = TESTS / "data" / "stored"
LIMIT_S = 20
MEMORY = 6 * 2**30
USED_PIXELS = 20_000
"""Scenes and rigs with more are read, and not predicted or drawn."""


class TooSlowError(BaseException):
    """A file took more of the processor than the limit; one that waits without end is ended by whoever started this."""


# -- mutations ---------------------------------------------------------------------------------------------------------

NASTY = (
    *(
        b"inf",
        b"-inf",
        b"nan",
        b"NaN",
        b"Infinity",
        b"0",
        b"-0.0",
        b"-1",
        b"0.1",
        b"1e6",
        b"1e-6",
        b"5e-324",
        b"1e-300",
    ),
    *(b"1e300", b"1e308", b"-1e308", b"1e5000", b"2147483648", b"9223372036854775807", b"-9223372036854775808"),
    *(b"9" * 18, b"9" * 30, b"9" * 5000, b"true", b"null", b"2026-01-01", b"\xff\xfe", b"\0"),
    *(b'""', b'"x"', b'"\\u0000"', b'"a\\nb"', b'"' + b"y" * 300 + b'"', b'"../../x"', b'"/"', b'"."', '"σ²"'.encode()),
    *(b"[]", b"{}", b"[[]]", b"[1, 2]", b"[1.0, 2.0, 3.0]", b"[1000000, 1000000]", b"[" * 3000 + b"]" * 3000),
    *(b"{ a = 1 }", b'{"a": 1}'),
)
"""What replaces a value of a text."""
_VALUE = re.compile(rb'-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?|"[^"\n]*"|\b(?:true|false|null)\b|\[[^\[\]\n]*\]')
_NUMBER = re.compile(rb"(?<![\w.])-?\d{1,9}\.\d{1,9}\b")
_WORD = re.compile(rb"\b[a-z_]{3,}\b")


def mutated_text(data: bytes, rng: random.Random) -> bytes:
    """A text with one to three of its words, numbers or lines changed."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        what = rng.random()
        tokens = [match.span() for match in (_WORD if rng.random() < 0.15 else _VALUE).finditer(data)]
        if what < 0.25 and (numbers := list(_NUMBER.finditer(data))):
            match = rng.choice(numbers)
            value = rng.choice((0.0, 0.1, 0.5, 0.99, 1.01, 2.0, 10.0)) * float(match[0]) + rng.choice((0.0, 0.0, 1.0))
            data = data[: match.start()] + f"{value:.6g}".encode() + data[match.end() :]
        elif what < 0.65 and tokens:
            start, end = rng.choice(tokens)
            other = tokens[rng.randrange(len(tokens))]
            data = data[:start] + (rng.choice(NASTY) if rng.random() < 0.8 else data[slice(*other)]) + data[end:]
        elif what < 0.85:
            lines = data.split(b"\n")
            at, kind = rng.randrange(len(lines)), rng.random()
            if kind < 0.4:
                del lines[at]
            elif kind < 0.7:
                lines.insert(rng.randrange(len(lines)), lines[at])
            else:
                other_at = rng.randrange(len(lines))
                lines[at], lines[other_at] = lines[other_at], lines[at]
            data = b"\n".join(lines)
        else:
            data = mutated_bytes(data, rng)
    return data


def mutated_bytes(data: bytes, rng: random.Random) -> bytes:
    """Bytes of which some are flipped, cut out, doubled or set to extremes; headers more often than the rest."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 4))):
        if not out:
            break
        at = rng.randrange(min(len(out), rng.choice((64, 256, len(out)))))
        kind = rng.random()
        if kind < 0.35:
            out[at] ^= 1 << rng.randrange(8)
        elif kind < 0.55:
            extreme, length = rng.choice((b"\xff", b"\0", b"\x7f", b"\x80")), rng.choice((1, 2, 4, 8))
            out[at : at + length] = extreme * length
        elif kind < 0.7:
            del out[at : at + rng.choice((1, 4, 64, len(out)))]
        elif kind < 0.85:
            out[at:at] = out[at : at + rng.choice((1, 16, 256))]
        else:
            out[at : at + 4] = rng.randbytes(4)
    return bytes(out)


def mutated_archive(data: bytes, rng: random.Random) -> bytes:
    """An .npz whose members are changed and packed again with right checksums, or whose own bytes are changed."""
    if rng.random() < 0.4:
        return mutated_bytes(data, rng)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name, kind = rng.choice(list(members)), rng.random()
    if kind < 0.6:
        head, rest = members[name][:128], members[name][128:]
        members[name] = (mutated_text if rng.random() < 0.5 else mutated_bytes)(head, rng) + rest
    elif kind < 0.75:
        members[name] = members[rng.choice(list(members))]
    elif kind < 0.85:
        del members[name]
    else:
        shape = rng.choice([(10**6, 10**6), (0, 0), (3,), (2**62, 2), (4, 4, 4), (1, 1)])
        text = io.BytesIO()
        np.lib.format.write_array_header_1_0(text, {"descr": "<f8", "fortran_order": False, "shape": shape})
        members[name] = text.getvalue() + bytes(128)
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as archive:
        for one, content in members.items():
            archive.writestr(one, content)
    return packed.getvalue()


# -- formats -----------------------------------------------------------------------------------------------------------

FORWARD = b"-1 0.0397887\n0.5 0.0994718\n1 0.1193662\n"
"""A phase function, 1/sr by cosine, that sends more light forward."""

Read = Callable[[bytes, int], bool]
"""Writes a mutated file where it belongs and reads it; whether what was accepted was used too."""


class Format:
    """One format: files to begin with, how they are mutated, and what reads them."""

    def __init__(self, originals: list[bytes], mutate: Callable[[bytes, random.Random], bytes], read: Read) -> None:
        self.originals, self.mutate, self.read = originals, mutate, read


def scene_files(folder: Path) -> Format:
    """Scenes, their phase tables and projector pictures beside them; the accepted are predicted."""
    shutil.copy(DOCS / "three_beams.png", folder)
    (folder / "phase.txt").write_bytes(FORWARD)
    plain = (TESTS / "data" / "reference" / "pub02.toml").read_bytes()
    small = plain.replace(b"[80, 120]", b"[8, 12]").replace(b"pixel_mm = 2.0", b"pixel_mm = 20.0")
    pinhole = small.replace(b'kind = "orthographic"', b'kind = "pinhole"\nposition_mm = [120.0, 0.0, 620.0]')
    table = small.replace(b"g = 0\n", b'[medium.phase]\nkind = "table"\nfile = "phase.txt"\n')
    terms = small.replace(
        b"g = 0\n", b'[medium.phase]\nkind = "two-term"\nforward = 0.9\nbackward = -0.4\nshare = 0.9\n'
    )
    bench = (DOCS / "bench_scene.toml").read_bytes()

    def read(data: bytes, number: int) -> bool:
        (folder / "scene.toml").write_bytes(data)
        scene = tankrig.load_scene(folder / "scene.toml")
        rows, columns = scene.camera.shape
        if number % 4 or rows * columns > USED_PIXELS or len(scene.projector.beams) > 50:
            return False
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            assert tankrig.predict(scene, "single").image.shape == (rows, columns)
        return True

    return Format([small, pinhole, table, terms, bench], mutated_text, read)


def phase_tables(folder: Path) -> Format:
    """Rows of cosine and value."""
    plain = (TESTS / "data" / "reference" / "pub02.toml").read_bytes()
    (folder / "scene.toml").write_bytes(plain.replace(b"g = 0\n", b'[medium.phase]\nkind = "table"\nfile = "p.txt"\n'))

    def read(data: bytes, _: int) -> bool:
        (folder / "p.txt").write_bytes(data)
        return bool(np.isfinite(tankrig.load_scene(folder / "scene.toml").medium.g)) and False

    return Format([FORWARD, b"# mu, p\n-1, 0.0795775\n0, 0.0795775\n1, 0.0795775\n"], mutated_text, read)


def sequence_files(folder: Path) -> Format:
    """Sequences; the accepted are drawn and gone through without moving anything."""
    from drivers.rig import SIMULATED, load_rig_file
    from tankrig.sequence import dry_run, load_sequence

    rig = load_rig_file(SIMULATED)
    example = (DOCS / "dilution.toml").read_bytes()
    rich = b"""name = "all kinds"
ink = { sigma_a = 1e-6, sigma_s = 0.004, g = 0.7 }
any_exposure = "steady light"
[patterns]
code = { kind = "gray-code", bit = 1, axis = "rows" }
sine = { kind = "phase-shift", period_px = 32.0, step = 1 }
fine = { kind = "checker", cell_px = 4 }
wave = { kind = "hadamard", index = 5, size = 8 }
[[steps]]
do = "repeat"
times = 3
steps = [{ do = "capture", pattern = "code", frames = 2, until = { sigma_s = "1 %" }, timeout_s = 60.0 },
         { do = "burst", patterns = ["fine", "wave"], times = 2, exposure_ms = 5.0 }, { do = "wait", seconds = 1.5 }]
[[steps]]
do = "dose"
total_ul = 50.0
[[steps]]
do = "mix"
pattern = "sine"
every_s = 0.5
"""

    def read(data: bytes, _: int) -> bool:
        (folder / "sequence.toml").write_bytes(data)
        sequence = load_sequence(folder / "sequence.toml")
        sequence.drawn(rig.bench.wall)
        took = dry_run(sequence, rig.limits, rig.pace, 19200, exposure=rig.exposure_rule)
        assert took.seconds >= 0.0
        return True

    return Format([example, rich], mutated_text, read)


def rig_files(folder: Path) -> Format:
    """Rig files; the accepted are asked what a dry run asks."""
    from drivers.rig import SIMULATED, calibrated_bench, load_rig_file, true_bench, true_liquids
    from tankrig.sequence import dry_run, load_sequence

    sequence = load_sequence(DOCS / "dilution.toml")
    originals = [SIMULATED.read_bytes(), SIMULATED.with_name("bench.toml").read_bytes()]
    originals += [(STORED / version / "finished" / "rig.toml").read_bytes() for version in ("1", "2")]

    def read(data: bytes, _: int) -> bool:
        (folder / "rig.toml").write_bytes(data)
        rig = load_rig_file(folder / "rig.toml")
        if rig.bench.camera.shape[0] * rig.bench.camera.shape[1] > 2**21 or np.prod(rig.bench.wall.shape) > 2**21:
            return False
        bench = calibrated_bench(rig)
        true_liquids(rig)
        true_bench(rig)
        sequence.drawn(bench.wall)
        dry_run(sequence, rig.limits, rig.pace, 19200, exposure=rig.exposure_rule)
        return True

    return Format(originals, mutated_text, read)


def arrays_and_pictures(folder: Path, suffix: str) -> Format:
    """Images to be fitted, raw frames and masks."""
    import cv2

    from tankrig.image.reading import read_frame, read_image, read_mask

    rng = np.random.default_rng(0)
    counts = rng.integers(0, 4000, (12, 16)).astype(np.uint16)
    if suffix == ".npz":
        text = io.BytesIO()
        np.savez_compressed(text, total=counts / 7.0, order1=counts / 9.0, x_mm=np.arange(16.0))
        originals, mutate = [text.getvalue()], mutated_archive
    elif suffix == ".npy":
        originals, mutate = [], lambda data, rng: (mutated_text if rng.random() < 0.5 else mutated_bytes)(data, rng)
        for pixels in (counts, counts / 7.0):
            text = io.BytesIO()
            np.save(text, pixels)
            originals.append(text.getvalue())
    else:
        kinds = [counts, (counts / 7.0).astype(np.float32)] if suffix == ".tiff" else [counts, 16 * counts]
        originals, mutate = [cv2.imencode(suffix, pixels)[1].tobytes() for pixels in kinds], mutated_bytes
    file = folder / f"image{suffix}"

    def read(data: bytes, number: int) -> bool:
        file.write_bytes(data)
        reader = (read_image, read_frame, read_mask)[number // 2 % 3]
        return reader(file).ndim == 2 and False

    return Format(originals, mutate, read)


def projected_pictures(folder: Path) -> Format:
    """Pictures on a projector: of a scene, and of a sequence."""
    import cv2

    from tankrig.pattern.kinds import ImageFile
    from tankrig.pattern.wall import Wall

    wall = Wall((192, 256), (-80.0, 80.0), (0.0, 120.0))
    (folder / "scene.toml").write_bytes((DOCS / "bench_scene.toml").read_bytes())
    beams = (DOCS / "three_beams.png").read_bytes()
    grey = cv2.imencode(".png", np.full((192, 256), 200, np.uint8))[1].tobytes()
    file = folder / "three_beams.png"

    def read(data: bytes, number: int) -> bool:
        file.write_bytes(data)
        if number % 2:
            return ImageFile(str(file)).draw(wall).shape == (192, 256) and False
        return bool(tankrig.load_scene(folder / "scene.toml").projector.beams) and False

    return Format([beams, grey], mutated_bytes, read)


def calibration_files(folder: Path) -> Format:
    """Results of calibrations; with the checksum that the changed text has, so that what it says is looked at too."""
    from hashlib import sha256

    from drivers.rig import SIMULATED, load_rig_file
    from tankrig.calibration.file import load
    from tankrig.calibration.geometry_in_force import measured
    from tankrig.calibration.radiometry import Radiometry

    stored = sorted((STORED / "1" / "calibration").glob("*.toml"))
    for file in stored:
        shutil.copy(file.with_suffix(".npz"), folder) if file.with_suffix(".npz").exists() else None
    bench = load_rig_file(SIMULATED).bench

    def sealed(data: bytes, rng: random.Random) -> bytes:
        text = mutated_text(data.partition(b"\n")[2], rng)
        if rng.random() < 0.2:
            return mutated_text(data, rng)
        return b'sha256 = "' + sha256(text).hexdigest().encode() + b'"\n' + text

    def read(data: bytes, number: int) -> bool:
        file = folder / stored[number % len(stored)].name
        file.write_bytes(data)
        found = load(file)
        if found.kind == "radiometry":
            Radiometry.of(found)
        elif found.kind in ("camera", "projector", "tank"):
            measured(bench, {found.kind: found})
        return False

    return Format([file.read_bytes() for file in stored], sealed, read)


def pump_calibrations(folder: Path) -> Format:
    """Results of weighing doses."""
    from tankrig.calibration.pump import load_pump_calibration

    def read(data: bytes, _: int) -> bool:
        (folder / "pump.toml").write_bytes(data)
        return load_pump_calibration(folder / "pump.toml").correction > 0.0 and False

    return Format([(STORED / "1" / "pump.toml").read_bytes()], mutated_text, read)


def run_parts(folder: Path, part: str) -> Format:
    """Runs of both layouts with one of their files changed: opened, read whole, recovered."""
    from tankrig.live.exposures import exposures_of
    from tankrig.run.recovery import dose_doubt, recover
    from tankrig.run.start import known_by_journal

    runs = []
    for version in ("1", "2"):
        for name in ("finished", "in-a-dose"):
            shutil.copytree(STORED / version / name / "run", folder / f"{version}-{name}", dirs_exist_ok=True)
            runs.append(folder / f"{version}-{name}")
    originals = [(run / part).read_bytes() for run in runs]

    def read(data: bytes, number: int) -> bool:
        run = runs[number % len(runs)]
        (run / part).write_bytes(data)
        try:
            found = tankrig.open_run(run)
            str(found.end), found.tank, found.patterns, found.conditions, found.unsure_doses, dose_doubt(found)
            known_by_journal(found)
            frames = found.frames
            for frame in range(frames.sizes["frame"]):
                frames[frame].values.sum()
            exposures_of(found)
            if number % 5 == 0:
                recover(run)
        finally:
            (run / part).write_bytes(originals[number % len(runs)])
            for left in (run / "journal.jsonl.torn", run / "report.html"):
                left.unlink(missing_ok=True)
        return False

    mutate = mutated_bytes if part.startswith("frames/c") else mutated_text
    return Format(originals, mutate, read)


def ledgers(folder: Path) -> Format:
    """What tanks hold."""
    from tankrig.dosing import TankLedger

    file = folder / "tank.ledger"
    stored = sorted(STORED.glob("*/*/simulated/tank.ledger"))

    def read(data: bytes, _: int) -> bool:
        file.unlink(missing_ok=True)
        file.write_bytes(data)
        ledger = TankLedger(file)
        try:
            ledger.account("rig-doser 7")
        finally:
            ledger.close()
        return False

    return Format([path.read_bytes() for path in stored], mutated_text, read)


def count_files(folder: Path) -> Format:
    """What pumps' counters mean."""
    from drivers.counted.record import CountFile

    stored = sorted(STORED.glob("*/count-files/*/count"))
    ticks = {path: float(json.loads(path.read_bytes())["tick_ul"]) for path in stored}
    file = folder / "count"

    def read(data: bytes, number: int) -> bool:
        file.unlink(missing_ok=True)
        file.write_bytes(data)
        count = CountFile(file, "pump", ticks[stored[number % len(stored)]])
        try:
            str(count.record.total)
        finally:
            count.close()
        return False

    return Format([path.read_bytes() for path in stored], mutated_text, read)


def prepared_models(folder: Path) -> Format:
    """Models in the cache: a changed one answers, or counts as missing."""
    from tankrig.light.prepared.box import Box
    from tankrig.light.prepared.cache import Place
    from tankrig.light.prepared.packing import unpacked
    from tankrig.light.prepared.plan import PreparationPlan
    from tankrig.light.prepared.polynomials import Plane
    from tankrig.scene import Medium

    place = Place(folder, "model")
    file = place.model
    rng = np.random.default_rng(1)
    arrays: dict[str, np.ndarray] = {"patterns": rng.random((4, 96)).astype(np.float32)}
    arrays["error"] = np.full((2, 2, 2), -2.0)
    for index in range(2):
        arrays[f"term{index}_power"] = np.array(index + 1)
        arrays[f"term{index}_planes"] = np.array([[2.0, 1.0, 1.0], [1.0, 1.0, 1.0]])
        arrays[f"term{index}_amplitudes"] = rng.random((3, Plane((2, 1), 1.0).size, 4))
        arrays[f"term{index}_scale"] = rng.random((2, Plane((1, 1), 1.0).size))
    arrays |= {"noise_scale": rng.random((3, Plane((1, 1), 1.0).size)), "tables": np.array(0.001)}
    arrays["misses"] = rng.random((3, 96)).astype(np.float32)
    arrays["noise_pull"] = rng.random((3, Plane((2, 1), 1.0).size, 5))
    arrays["noise_left"] = rng.random((5, 3, 24)).astype(np.float32)
    place.keep(file, arrays)
    original = file.read_bytes()
    coordinates = PreparationPlan(Box(), 240.0, 0.01).coordinates

    def read(data: bytes, _: int) -> bool:
        file.write_bytes(data)
        known = place.kept(file)
        if known is None:
            return False
        try:
            answer = unpacked(known, coordinates, (8, 12), 24)
        except (KeyError, TypeError, ValueError):
            return False  # made again, see `tankrig.light.prepared.preparation`
        answer.image_and_derivatives(Medium(0.001, 0.02, 0.5))
        answer.errors_at(Medium(0.001, 0.02, 0.5))
        answer.errors_of_slopes_at(Medium(0.001, 0.02, 0.5))
        answer.misses_at(Medium(0.001, 0.02, 0.5))
        answer.error_over_box()
        return False

    return Format([original], mutated_archive, read)


FORMATS: dict[str, Callable[[Path], Format]] = {
    "scene": scene_files,
    "phase-table": phase_tables,
    "sequence": sequence_files,
    "rig": rig_files,
    "npz": lambda folder: arrays_and_pictures(folder, ".npz"),
    "npy": lambda folder: arrays_and_pictures(folder, ".npy"),
    "png": lambda folder: arrays_and_pictures(folder, ".png"),
    "tiff": lambda folder: arrays_and_pictures(folder, ".tiff"),
    "projected": projected_pictures,
    "calibration": calibration_files,
    "pump": pump_calibrations,
    "journal": lambda folder: run_parts(folder, "journal.jsonl"),
    "settings": lambda folder: run_parts(folder, "zarr.json"),
    "frames-metadata": lambda folder: run_parts(folder, "frames/zarr.json"),
    "patterns-metadata": lambda folder: run_parts(folder, "patterns/zarr.json"),
    "chunk": lambda folder: run_parts(folder, "frames/c.2.0.0"),
    "ledger": ledgers,
    "count": count_files,
    "prepared": prepared_models,
}


def main(name: str, first: int, count: int, folder: Path) -> None:
    """Read mutations number first … first + count − 1."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    place = folder / f"{name}-{first}"
    place.mkdir(parents=True, exist_ok=True)
    format_ = FORMATS[name](place)
    for number, original in enumerate(format_.originals):  # else every mutation of it is refused for nothing
        format_.read(original, number)
    at = os.open(folder / "at", os.O_RDWR | os.O_CREAT, 0o644)
    told = {"refused": 0, "accepted": 0, "used": 0, "failed": []}

    def too_slow(*_: object) -> None:
        raise TooSlowError

    signal.signal(signal.SIGPROF, too_slow)
    for number in range(first, first + count):
        os.pwrite(at, f"{number:12d}".encode(), 0)
        rng = random.Random(f"{name} {number}")
        data = format_.mutate(format_.originals[number % len(format_.originals)], rng)
        signal.setitimer(signal.ITIMER_PROF, LIMIT_S)
        try:
            used = format_.read(data, number)
            told["accepted"] += 1
            told["used"] += used
        except TankrigError as error:
            told["refused"] += 1
            if not str(error).strip() or len(str(error)) > 4000:
                told["failed"].append([number, f"no sentence: {str(error)[:200]}"])
        except BaseException as error:
            where = traceback.extract_tb(error.__traceback__)[-1]
            said = " ".join(f"{type(error).__name__}: {error} ({Path(where.filename).name}:{where.lineno})".split())
            told["failed"].append([number, said[:300]])
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0.0)
    os.close(at)
    print(json.dumps(told), flush=True)


if __name__ == "__main__":
    batches = iter(sys.argv[2:])
    for name, first, count in zip(batches, batches, batches, strict=True):
        main(name, int(first), int(count), Path(sys.argv[1]))
