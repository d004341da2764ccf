"""Hold an object of unknown weight and friction with as little force as is safe.

docs/hold.md has the commands. Replace `EmulatedGripper` by your hand: its module says what is assumed.
"""

import json
import socket
import sys
import time

from tactiled.client import GripController, GripMessage, Stale, Subscription

SAY_S = 0.5  # between two lines on the terminal


class EmulatedGripper:
    """Gripper of `tactiled emulate --control`."""

    def __init__(self, address: str) -> None:
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.connect(address.removeprefix("unix://"))
        self._answers = self._socket.makefile()

    def move(self, force_n: float) -> float:
        """Command a force; return the one that is exerted now. Ends the program when the scene is over."""
        self._socket.sendall(json.dumps({"grip_n": force_n}).encode() + b"\n")
        answer = json.loads(self._answers.readline())
        if not answer["ok"] or answer["fallen"]:
            sys.exit(answer.get("error", "dropped"))
        if answer["scene_s"] >= answer["duration_s"]:
            print(f"held with {answer['grip_n']:.1f} N", file=sys.stderr)
            sys.exit()
        return float(answer["grip_n"])


def main(address: str, endpoint: str = "tcp://127.0.0.1:9872") -> None:
    """Hold until the scene is over, or Ctrl-C."""
    gripper, controller, said_s = EmulatedGripper(address), GripController(), 0.0
    present_n = gripper.move(controller.command_n)
    with Subscription(endpoint, topics=("grip",)) as subscription:
        while True:
            match subscription.next_item(time.monotonic() + 0.1):
                case GripMessage(data=grip) if subscription.fresh:
                    present_n = gripper.move(controller.take(grip, present_n))
                    if grip["timestamp"] > said_s + SAY_S:
                        said_s = grip["timestamp"]
                        print(f"{present_n:.1f} N {grip['state']} {grip['utilisation']:.2f}", file=sys.stderr)
                case Stale() | None:
                    present_n = gripper.move(controller.blind())


if __name__ == "__main__":
    if len(sys.argv) not in (2, 3):
        sys.exit("usage: python hold.py unix://PATH [ENDPOINT]   (PATH: --control of tactiled emulate)")
    try:
        main(*sys.argv[1:])
    except KeyboardInterrupt:
        pass
    except (ConnectionError, FileNotFoundError, json.JSONDecodeError):
        sys.exit("no answer from the emulator: start it first, and again for each grasp")
