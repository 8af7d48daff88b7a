"""kill -9 while a record is saved: at every line of the store's code, in the middle of a write, at random moments with two writers at once.

After each death the store opens: the record in force is the old one or the new one, whole; what the dead leave does not grow.
"""

from __future__ import annotations

import errno
import itertools
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
from calibration_samples import make_record

from gyro_calib.calibration import (
    CalibrationRecord,
    FactoryRecord,
    FactoryStore,
    RecordMissingError,
    RecordStore,
    dump_record,
    files,
    store,
)
from gyro_calib.quantity import Quantity

DEVICE = "ring_15k-0007"
#: what the store may keep beside the record in force: versions, the reverted and the rejected one, one temporary a folder and a writer
KEEP = 3
MOST_FILES = 1 + KEEP + 2


def numbered(i: int) -> CalibrationRecord:
    return make_record(DEVICE, bias=Quantity(1e-6 * i, 1e-7, "rad/s"), bias_scale_covariance=0.0)


RECORDS = [numbered(i) for i in range(6)]
IDS = [record.record_id for record in RECORDS]
#: made once: the forked writers need not make them again
TEXTS = {record.record_id: dump_record(record) for record in RECORDS}


@pytest.fixture
def in_child() -> Iterator[Callable[[Callable[[], None]], int]]:
    """Function: start work in a forked process; whatever is alive at the end is killed."""
    children: list[int] = []

    def start(work: Callable[[], None]) -> int:
        pid = os.fork()
        if pid == 0:
            try:
                work()
            finally:
                os._exit(0)
        children.append(pid)
        return pid

    yield start
    for pid in children:
        try:
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
        except (ProcessLookupError, ChildProcessError):
            continue


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    """In memory where there is such a thing: a process that is killed does not take back what it has written, synced or not."""
    memory = Path("/dev/shm")
    if not os.access(memory, os.W_OK):
        yield tmp_path
        return
    with tempfile.TemporaryDirectory(dir=memory) as name:
        yield Path(name)


@pytest.fixture(autouse=True)
def _made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(store, "dump_record", lambda record: TEXTS[record.record_id])


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def die_at_line(number: int) -> None:
    """Kill this process before it carries out the ``number``-th line of the store from now on."""
    watched = {files.__file__, store.__file__, sys.modules[FactoryStore.__module__].__file__}
    left = [number]

    def lines(frame: FrameType, event: str, _: Any) -> Any:
        if event == "line":
            left[0] -= 1
            if left[0] <= 0:
                die()
        return lines

    sys.settrace(lambda frame, event, _: lines if frame.f_code.co_filename in watched else None)


def no_links() -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError(errno.EPERM, "no links here")

    os.link = refuse  # type: ignore[assignment]


@dataclass(frozen=True)
class Case:
    """Records saved before, what the victim does, and what may be in force after its death (None: nothing yet)."""

    before: tuple[int, ...]
    act: Callable[[RecordStore], object]
    allowed: tuple[int | None, ...]
    torn: bool = False


CASES = {
    "first": Case((), lambda s: s.save(RECORDS[1]), (None, 1)),
    "next, oldest dropped": Case((0, 1, 2, 4), lambda s: s.save(RECORDS[3]), (4, 3)),
    "without links": Case((1, 2), lambda s: (no_links(), s.save(RECORDS[3])), (2, 3)),
    "revert": Case((1, 2, 3), lambda s: s.revert(), (3, 2)),
    "over a torn one": Case((1, 2), lambda s: s.save(RECORDS[3]), (1, 3), torn=True),
}


def make_store(path: Path) -> RecordStore:
    return RecordStore(path / "gyro.yaml", DEVICE, keep=KEEP)


def in_force(found: RecordStore) -> int | None:
    try:
        return IDS.index(found.load_last_good().record.record_id)
    except RecordMissingError:
        return None


@pytest.mark.parametrize("name", CASES)
def test_a_writer_killed_at_every_line_leaves_the_old_or_the_new(name: str, folder: Path, in_child: Callable[..., int]) -> None:
    case = CASES[name]
    template = folder / "template"
    template.mkdir()
    for i in case.before:
        make_store(template).save(RECORDS[i])
    if case.torn:
        (template / "gyro.yaml").write_text("half a rec")
    outcomes: list[int | None] = []
    killed, line = True, 0
    while killed:
        line += 1
        place = folder / f"at_{line}"
        shutil.copytree(template, place)
        victim = make_store(place)

        def act(victim: RecordStore = victim, line: int = line) -> None:
            die_at_line(line)
            case.act(victim)
            sys.settrace(None)

        _, status = os.waitpid(in_child(act), 0)
        killed = os.WIFSIGNALED(status)
        outcomes.append(in_force(victim))
        assert outcomes[-1] in case.allowed, f"line {line}"
        left = [p.name for p in place.rglob("*tmp")]
        assert len(left) <= 1, f"line {line}: {left}"
        if line % 8 == 0 or not killed:  # the next one takes it up and clears away
            victim.save(RECORDS[5])
            assert in_force(victim) == 5
            assert not list(place.rglob("*tmp"))
            assert in_force_after_revert(victim) in (case.allowed if outcomes[-1] is not None else (None,))
        shutil.rmtree(place)
    assert len(outcomes) > 30
    assert (outcomes[0], outcomes[-1]) == case.allowed
    # it changes once, at the rename
    assert sum(before != after for before, after in itertools.pairwise(outcomes)) == 1


def in_force_after_revert(found: RecordStore) -> int | None:
    if not found.previous():
        return None
    return IDS.index(found.revert().record_id)


def test_a_factory_record_survives_its_writer_at_every_line(folder: Path, in_child: Callable[..., int]) -> None:
    def factory(kappa: float) -> FactoryRecord:
        angle = Quantity(0.0, 1e-6, "rad")
        return FactoryRecord(
            DEVICE, "2026-03-01T12:00:00Z", Quantity(kappa, 1e-5, "1"), Quantity(1.0, 1e-6, "1"), angle, angle, None, None, 25.0
        )

    old, new = factory(0.8), factory(0.81)
    found, killed, line = [], True, 0
    while killed:
        line += 1
        place = folder / f"at_{line}"
        FactoryStore(f"{place}/", DEVICE).save(old)

        def replace(place: Path = place, line: int = line) -> None:
            die_at_line(line)
            FactoryStore(f"{place}/", DEVICE).save(new, replace_existing=True)
            sys.settrace(None)

        _, status = os.waitpid(in_child(replace), 0)
        killed = os.WIFSIGNALED(status)
        found.append(FactoryStore(f"{place}/", DEVICE).load())
        assert found[-1] in (old, new), f"line {line}"
        shutil.rmtree(place)
    assert (found[0], found[-1]) == (old, new)


@pytest.mark.parametrize("share", [0.0, 0.5, 0.999])
def test_a_writer_killed_in_the_middle_of_its_write_leaves_the_old_one(tmp_path: Path, in_child: Callable[..., int], share: float) -> None:
    victim = make_store(tmp_path)
    victim.save(RECORDS[1])

    def work() -> None:
        real = os.write

        def half(fd: int, data: Any) -> int:
            real(fd, data[: int(share * len(data))])
            die()
            return 0

        os.write = half
        victim.save(RECORDS[2])

    _, status = os.waitpid(in_child(work), 0)
    assert os.WTERMSIG(status) == signal.SIGKILL
    (torn,) = tmp_path.rglob("*tmp")
    assert torn.stat().st_size == int(share * len(TEXTS[IDS[2]]))
    assert in_force(victim) == 1


def test_two_writers_killed_at_random_moments(folder: Path, in_child: Callable[..., int]) -> None:
    shared = make_store(folder)
    shared.save(RECORDS[0])
    rng = random.Random(1)

    def save_for_ever(mine: list[CalibrationRecord]) -> None:
        while True:
            for record in mine:
                make_store(folder).save(record)

    changed: set[int | None] = set()
    most = 0
    for _ in range(60):
        pids = [in_child(lambda mine=mine: save_for_ever(mine)) for mine in rng.sample([RECORDS[1:3], RECORDS[3:5]], 2)]
        time.sleep(rng.uniform(0.003, 0.04))
        for pid in pids:
            os.kill(pid, signal.SIGKILL)
        for pid in pids:
            os.waitpid(pid, 0)
        changed.add(IDS.index(shared.load().record_id))  # never torn, never missing: load() takes no previous version
        most = max(most, sum(1 for p in folder.rglob("*") if p.is_file()))
    assert len(changed) > 3  # they did save
    assert most <= MOST_FILES + 1, "what the dead leave must not grow"
    shared.save(RECORDS[5])
    assert not list(folder.rglob("*tmp"))
    assert {v.record.record_id for v in shared.previous()} <= set(IDS)
    assert shared.load().record_id == IDS[5]
