"""The worker thread: same results as in place, none waited for, none computed in vain."""

import os
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from patience import PATIENCE_S
from recordings import SOURCE, simulated_reads

from tactiled.daemon.operations.background import BackgroundWorker
from tactiled.detect.grooves import estimator
from tactiled.detect.grooves.fit import fit_wave
from tactiled.detect.suite import DetectParams
from tactiled.detect.worker import pause
from tactiled.events.types import Event, ScanEvent, TextureEvent
from tactiled.pipeline import Pipeline, PipelineParams
from tactiled.recording.contents import Read

PARAMS = PipelineParams(detect=DetectParams.model_validate({"texture": {"preset": "quick", "hop_s": 0.5}}))


def until(condition: Callable[[], bool], what: str) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline_s, what
        time.sleep(0.001)


def is_idle(background: BackgroundWorker) -> bool:
    """Return True while no wanted job is computed or waits."""
    with background._changed:  # noqa: SLF001  nothing else needs to know
        waits = any(job.is_wanted for job in background._jobs)  # noqa: SLF001
        return background._running is None and not waits  # noqa: SLF001


def test_a_job_gives_its_result_and_an_error_comes_to_the_caller() -> None:
    with BackgroundWorker() as background:
        done = threading.Event()

        def fail() -> None:
            done.set()
            raise ZeroDivisionError

        good, bad = background.submit(lambda: 7), background.submit(fail)
        assert done.wait(20)
        until(lambda: is_idle(background), "idle")
        assert good.result() == 7
        with pytest.raises(ZeroDivisionError):
            bad.result()


def test_a_job_that_is_given_up_ends_at_its_next_pause() -> None:
    with BackgroundWorker() as background:
        began = threading.Event()

        def endless() -> int:
            while True:
                began.set()
                pause()

        job = background.submit(endless)
        assert began.wait(20)
        waiting = [background.submit(lambda: 1) for _ in range(3)]
        assert [each.result() for each in waiting] == [None] * 3
        assert job.result() is None
        assert background.submit(lambda: 2) is not None
        until(lambda: is_idle(background), "the endless job has ended")


def test_the_newest_job_comes_first() -> None:
    order: list[int] = []
    with BackgroundWorker() as background:
        began, may_go_on = threading.Event(), threading.Event()

        def first() -> None:
            began.set()
            assert may_go_on.wait(20)

        running = background.submit(first)
        assert began.wait(20)
        jobs = [background.submit(lambda number=number: order.append(number)) for number in range(3)]  # type: ignore[misc]
        may_go_on.set()
        until(lambda: is_idle(background), "all jobs are done")
        assert order == [2, 1, 0]
        assert [job.result() for job in (running, *jobs)] == [None] * 4


def test_boards_take_turns_and_the_newest_job_of_each_comes_first() -> None:
    order: list[str] = []
    with BackgroundWorker() as background:
        began, may_go_on = threading.Event(), threading.Event()

        def first() -> None:
            began.set()
            assert may_go_on.wait(20)

        boards = {name: background.of_board() for name in "abc"}
        boards["a"].submit(first)
        assert began.wait(20)
        for name in ("a1", "c1", "a2", "a3", "b1", "a4", "b2"):
            boards[name[0]].submit(lambda name=name: order.append(name))  # type: ignore[misc]
        may_go_on.set()
        until(lambda: is_idle(background), "all jobs are done")
    assert order == ["b2", "c1", "a4", "b1", "a3", "a2", "a1"]


def test_leaving_the_block_ends_a_running_job() -> None:
    with BackgroundWorker() as background:
        began = threading.Event()

        def endless() -> None:
            while True:
                began.set()
                pause()

        background.submit(endless)
        assert began.wait(20)
    assert not any(thread.name == "groove fits" for thread in threading.enumerate())


def events_of(pipeline: Pipeline, reads: list[Read], late: dict[int, list[int]] | None = None) -> list[Event]:
    """Events with fits in place; `late` holds the late fits of a live run, by the read they belong to."""
    events: list[Event] = []
    for number, read in enumerate(reads):
        for index in (late or {}).get(number, ()):
            pipeline.command("late-fit", {"index": index}, read.arrival_s)
        events += [e for e in pipeline.receive_data(read.data, read.arrival_s) if isinstance(e, Event)]
    return events


@pytest.fixture(scope="module")
def reads() -> list[Read]:
    """The demo's scene up to its second slide, over grooves."""
    return simulated_reads(20.0)


@pytest.fixture(scope="module")
def in_place(reads: list[Read]) -> list[Event]:
    return events_of(Pipeline(SOURCE.layout, SOURCE.array, PARAMS), reads)


@pytest.fixture(params=[1, 2])
def cores(request: pytest.FixtureRequest) -> Iterator[int]:
    """Threads that begin in the test run on so many cores, where there are as many."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, sorted(before)[: request.param])
    yield request.param
    os.sched_setaffinity(0, before)


@pytest.mark.usefixtures("cores")
def test_events_are_those_of_fits_in_place(reads: list[Read], in_place: list[Event]) -> None:
    assert any(isinstance(e, TextureEvent) and e.status == "ok" for e in in_place)
    with BackgroundWorker() as background:
        pipeline = Pipeline(SOURCE.layout, SOURCE.array, PARAMS, worker=background)
        beside: list[Event] = []
        for read in reads:
            beside += [e for e in pipeline.receive_data(read.data, read.arrival_s) if isinstance(e, Event)]
            until(lambda: is_idle(background), "the fit is done")  # the scans come faster than in real time
        assert pipeline.health().fits_late == 0
    assert beside == in_place


def test_a_fit_that_never_ends_delays_no_scan_is_counted_and_replayed(
    reads: list[Read], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three fits do not end: all scans pass meanwhile, and the replay has the same refusals."""
    is_blocked = threading.Event()
    is_blocked.set()

    def slow(*args: Any) -> Any:
        while is_blocked.is_set():
            pause()
        return fit_wave(*args)

    late: dict[int, list[int]] = {}
    live: list[Event] = []
    with monkeypatch.context() as patched, BackgroundWorker() as background:
        patched.setattr(estimator, "fit_wave", slow)
        pipeline = Pipeline(SOURCE.layout, SOURCE.array, PARAMS, worker=background)
        for number, read in enumerate(reads):
            live += [e for e in pipeline.receive_data(read.data, read.arrival_s) if isinstance(e, Event)]
            if pipeline.late_fits:
                late[number] = pipeline.late_fits
            if len(late) == 3:
                is_blocked.clear()
                until(lambda: is_idle(background), "the fit is done")
    health = pipeline.health()
    assert health.fits_late == 3
    assert health.scans == sum(isinstance(e, ScanEvent) for e in live) > 1500
    assert any(isinstance(e, TextureEvent) and e.status == "ok" for e in live)
    assert events_of(Pipeline(SOURCE.layout, SOURCE.array, PARAMS), reads, late) == live


def test_what_cannot_be_loaded_is_raised_as_the_result_of_each_job() -> None:
    may_fail = threading.Event()

    def prepare() -> None:
        assert may_fail.wait(PATIENCE_S)
        raise ImportError("no such library")

    with BackgroundWorker(prepare) as background:
        early = background.submit(lambda: 1)
        may_fail.set()
        until(lambda: is_idle(background), "the early job has its error")
        late = background.submit(lambda: 1)
        until(lambda: is_idle(background), "the late job has its error")
        for job in (early, late):
            with pytest.raises(ImportError, match="no such library"):
                job.result()
