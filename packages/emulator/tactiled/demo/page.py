"""``tactiled demo --web``: emulated board, daemon and live page as processes, until Ctrl-C."""

import contextlib
import time
import webbrowser
from contextlib import ExitStack
from queue import Queue

import click

from tactiled.demo.play import SCENE, DemoError, Lines, await_line, demo_folder, process, take_lines
from tactiled.emulator.scene.description import load_scene

_REST_S = 8.0  # between two plays: the board is pulled out and plugged in again, as the lamp shows


def run_page_demo(port: int, *, opens: bool) -> None:
    """Play the demo scene again and again below the live page, until Ctrl-C.

    With `opens`, the browser of this desktop shows the page. `DemoError` where a process does not start or
    ends.
    """
    play_s = load_scene(SCENE).duration_s + _REST_S
    lines: Lines = Queue()
    with ExitStack() as stack:
        folder, link, endpoint, config = stack.enter_context(demo_folder())
        stack.enter_context(process("daemon", ("run", "--config", str(config)), lines, folder))
        page = ("web", "--events", endpoint, "--port", str(port), "--allow-commands")
        stack.enter_context(process("page", page, lines, folder))
        url = await_line(lines, "page", "the address of the page")["url"]
        click.echo(f"The page: {url}\nCtrl-C ends the demo.", err=True)
        if opens:
            webbrowser.open(url)
        with contextlib.suppress(KeyboardInterrupt):
            while True:
                with process("board", ("emulate", "--scene", SCENE, "--link", str(link)), lines, folder):
                    until_s = time.monotonic() + play_s
                    while time.monotonic() < until_s:
                        for name, message in take_lines(lines):
                            if message is None and name != "board":  # a board ends after each play
                                raise DemoError(f"the {name} process ended; see above")
