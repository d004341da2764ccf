"""Queues of slow browsers."""

import asyncio
from typing import Any, cast

import pytest
from frames import unpack

from tactiled.web.browsers import Browser
from tactiled.web.feed import Frames


class SlowSocket:
    """Socket that needs a turn of the loop for each frame, in which three more frames come."""

    closed = False

    def __init__(self) -> None:
        self.browser: Browser | None = None
        self.sent = 0

    async def send_bytes(self, frame: bytes) -> None:  # noqa: ARG002  the signature of aiohttp
        self.sent += 1
        assert self.sent < 10_000, "never given up"
        assert self.browser is not None
        for _ in range(3):
            self.browser.offer(Frames(b"event", b"scan"))
        await asyncio.sleep(0)


def test_a_browser_that_reads_too_slowly_for_ever_is_given_up() -> None:
    socket: Any = SlowSocket()
    socket.browser = Browser(socket)
    socket.browser.offer(Frames(b"event", None))
    asyncio.run(socket.browser.send_all())
    assert 400 < socket.sent < 600  # two more wait after each: 1000 of them after 500


class Link:
    """Socket of a browser that answers when it is told to."""

    closed = False

    def __init__(self) -> None:
        self.sent: list[bytes] = []

    async def send_bytes(self, frame: bytes) -> None:
        self.sent.append(frame)


def test_what_a_slow_link_gets_is_new_and_every_event_is_among_it() -> None:
    async def main() -> list[bytes]:
        link = Link()
        browser = Browser(cast(Any, link))
        sending = asyncio.create_task(browser.send_all())
        for n in range(100):
            browser.offer(Frames(b"event %d" % n if n % 10 == 0 else None, b"scan %d" % n))
            await asyncio.sleep(0)
        unanswered = [*link.sent]
        browser.answered(str(len(unanswered)))
        await asyncio.sleep(0)
        sending.cancel()
        scans = [frame for frame in unanswered if frame.startswith(b"scan")]
        assert scans == [b"scan %d" % n for n in range(2)]
        assert [frame for frame in unanswered if frame not in scans] == [
            b"event %d" % n for n in range(0, 100, 10)
        ]
        return link.sent[len(unanswered) :]

    dropped, *scans = asyncio.run(main())
    assert unpack(dropped) == {"dropped": 96}
    assert scans == [b"scan 98", b"scan 99"]


@pytest.mark.parametrize(
    ("answers", "room"),
    [(["2"], 2), (["1"], 1), (["2", "1"], 2), (["3"], 3), (["99"], 3), ([""], 0), (["-3", "x", b"2"], 0)],
)
def test_an_answer_makes_room_for_the_frames_that_it_counts(answers: list[object], room: int) -> None:
    async def main() -> list[int]:
        link = Link()
        browser = Browser(cast(Any, link))
        sending = asyncio.create_task(browser.send_all())
        n_sent = []
        for is_answered in (False, True):
            for answer in answers if is_answered else ():
                browser.answered(answer)
            for n in range(4):
                await asyncio.sleep(0)
                browser.offer(Frames(None, b"scan %d" % n))
            await asyncio.sleep(0)
            n_sent.append(len(link.sent))
        sending.cancel()
        return n_sent

    assert asyncio.run(main()) == [3, 3 + room]


def test_a_browser_that_keeps_up_gets_one_frame_in_place_of_two() -> None:
    async def main() -> list[bytes]:
        link = Link()
        browser = Browser(cast(Any, link))
        sending = asyncio.create_task(browser.send_all())
        for n in range(4):
            browser.offer(Frames(b"event %d" % n, b"scan %d" % n, b"both %d" % n))
            await asyncio.sleep(0)
        sending.cancel()
        return link.sent

    assert asyncio.run(main()) == [b"both 0", b"both 1", b"both 2", b"event 3"]


def test_frames_that_the_history_holds_are_not_sent_again() -> None:
    async def main() -> list[bytes]:
        link = Link()
        browser = Browser(cast(Any, link))
        for n in range(5):  # while the connection is being prepared
            browser.offer(Frames(b"event %d" % n, b"scan %d" % n))
        browser.forget()
        browser.offer(Frames(b"event 5", b"scan 5"))
        sending = asyncio.create_task(browser.send_all())
        await asyncio.sleep(0)
        sending.cancel()
        return link.sent

    assert asyncio.run(main()) == [b"event 5", b"scan 5"]
