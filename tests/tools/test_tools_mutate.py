"""Small faults of `./run mutate`: which are made, and that tests are said to find them or not."""

import subprocess
import textwrap
from pathlib import Path

import pytest

from tools import mutate
from tools.mutations import mutations


def changes(text: str) -> set[str]:
    """Every mutation of a text as `old -> new`."""
    found = mutations(textwrap.dedent(text), "a.py")
    return {str(one).partition(": ")[2] for place in found for one in place}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("x = a < b", {"a < b -> (a <= b)", "a < b -> (a >= b)"}),
        ("x = a + b", {"a + b -> (a - b)"}),
        ("x = a and b", {"a and b -> (a or b)"}),
        ("x = not a", {"not a -> (a)"}),
        ("x = -a", {"-a -> (a)"}),
        ("x = True", {"True -> False"}),
        ("x = 3", {"3 -> (4)", "3 -> (2)"}),
        ("x += a", {"x += a -> x -= a", "x += a -> pass"}),
        ("x.y = a", {"x.y = a -> pass"}),
        ("call(a)", {"call(a) -> pass"}),
        ("if a:\n    x = b", {"a -> not (a)"}),
        ("def f():\n    return a", {"return a -> return None"}),
    ],
)
def test_each_kind_of_fault_is_made(text: str, expected: set[str]) -> None:
    assert changes(text) == expected


@pytest.mark.parametrize(
    "text",
    [
        '"""Text of 3 words."""',
        "x: Literal[3]",
        "def f(a: list[1]) -> tuple[2]: ...",
        'log.warning("late by %d", 3)',
        'x = f"{a + 3}"',
        'x = "%d" % a',
        "x = int | None",
        "__slots__ = (1,)",
        "@dataclass(frozen=True)\nclass C: ...",
        "if TYPE_CHECKING:\n    x = 3",
        "def f():\n    return None",
    ],
)
def test_texts_logs_and_types_stay_as_they_are(text: str) -> None:
    assert changes(text) == set()


def test_a_change_replaces_its_own_characters_only() -> None:
    text = "µ, x = 'µ', a < b  # µ\ny = c\n"
    ((first, _),) = mutations(text, "a.py")
    assert first.apply(text) == "µ, x = 'µ', (a <= b)  # µ\ny = c\n"


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """Git checkout with one room, of which the tests notice half."""
    source = '''
        """Room."""

        LIMIT = 3


        def seen(x):
            return x < LIMIT


        def unseen(x):
            return x < LIMIT


        def endless(x):
            while x > 0:
                x -= 1
            return x
    '''
    test = """
        from tactiled.room.part import endless, seen

        def test_seen():
            assert [seen(x) for x in (2, 3)] == [True, False]

        def test_endless():
            assert endless(3) == 0
    """
    files = {
        "tactiled/room/part.py": source,
        "tactiled/room/__init__.py": "",
        "tests/room/test_room.py": test,
    }
    for name, text in {
        **files,
        "pytest.ini": "[pytest]\npythonpath = .\n",
    }.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(textwrap.dedent(text))
    subprocess.run(["git", "init", "-q", str(tmp_path)], check=True)
    return tmp_path


def test_survivors_are_the_faults_that_no_test_notices(
    checkout: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mutate, "_LEAST_TIMEOUT_S", 1.0)  # for `x -= 1 -> pass`
    before = {path: path.read_bytes() for path in checkout.rglob("*.py")}
    score = mutate.measure(checkout, "room", count=100, seed=0)
    survivors = capfd.readouterr().out.splitlines()
    assert [line.partition(": ")[0] for line in survivors[:-1]] == 2 * ["survived tactiled/room/part.py:12"]
    assert survivors[-1] == f"room: 9 of 11 mutations killed, {score:.0%} (seed 0)"
    assert {path: path.read_bytes() for path in checkout.rglob("*.py")} == before


def test_tests_that_fail_without_a_fault_are_an_error(checkout: Path) -> None:
    (checkout / "tests/room/test_room.py").write_text("def test_no():\n    assert False\n")
    with pytest.raises(SystemExit, match="the tests fail without a mutation"):
        mutate.measure(checkout, "room", count=1, seed=0)


def test_an_unknown_room_is_an_error(checkout: Path) -> None:
    with pytest.raises(SystemExit, match="there is no tactiled/attic"):
        mutate.measure(checkout, "attic", count=1, seed=0)
