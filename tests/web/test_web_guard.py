"""Which requests the page server accepts."""

import json

import pytest

from tactiled.web.commands import check_request
from tactiled.web.guard import Guard, is_loopback

TOKEN = "0123456789abcdef"


@pytest.mark.parametrize("host", ["127.0.0.1:8765", "localhost:8765", "[::1]:8765", "192.168.1.7:80", "hand"])
def test_addresses_and_own_names_are_accepted(host: str) -> None:
    assert Guard(host_names=("hand",)).refuse_host(host) == ""


@pytest.mark.parametrize("host", ["evil.example", "evil.example:8765", "127.0.0.1.evil.example", "", "["])
def test_a_name_that_resolves_to_this_host_is_refused(host: str) -> None:
    assert "--host-name" in Guard().refuse_host(host)


@pytest.mark.parametrize(
    "origin",
    [
        "http://evil.example",
        "http://127.0.0.1:1",
        "null",
        "file://",
        "https://127.0.0.1:8765.evil",
        "http://[",
    ],
)
def test_pages_of_other_origins_are_refused(origin: str) -> None:
    assert Guard().refuse_origin(origin, "127.0.0.1:8765")


def test_the_page_itself_and_programs_are_accepted() -> None:
    assert Guard().refuse_origin("http://127.0.0.1:8765", "127.0.0.1:8765") == ""
    assert Guard().refuse_origin(None, "127.0.0.1:8765") == ""


@pytest.mark.parametrize(
    "given",
    [None, "", "Bearer", "Bearer ", f"Basic {TOKEN}", f"Bearer {TOKEN}x", "Bearer é", "Bearer \udcff"],
)
def test_a_command_needs_the_token(given: str | None) -> None:
    assert "token" in Guard(TOKEN).refuse_command(given)


def test_the_token_admits_and_without_one_nothing_does() -> None:
    assert Guard(TOKEN).refuse_command(f"Bearer {TOKEN}") == ""
    assert "--allow-commands" in Guard().refuse_command("Bearer ")


@pytest.mark.parametrize(
    ("document", "words"),
    [
        ([], "object"),
        ({"do": "events"}, "no command"),
        ({"do": "tare", "board": "a\0b"}, "not a serial number"),
        ({"do": "tare", "source": 1}, "source"),
        ({"do": "tare", "source": True}, "source"),
        ({"do": "inhibit", "fields": {"duration_s": "1"}}, "no float"),
        ({"do": "inhibit", "fields": {"duration_s": True}}, "no float"),
        ({"do": "mark", "fields": {"who": "me"}}, "no field"),
        ({"do": "mark", "fields": []}, "fields"),
    ],
)
def test_what_is_no_command_is_refused_with_the_reason(document: object, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        check_request(json.dumps(document).encode(), 1)


def test_a_number_is_sent_as_a_float() -> None:
    body = b'{"do": "speed", "fields": {"speed_mm_s": 2}}'
    assert check_request(body, 1) == (0, "speed", {"speed_mm_s": 2.0})


def test_loopback_addresses() -> None:
    assert [is_loopback(host) for host in ("127.0.0.1", "::1", "localhost")] == [True] * 3
    assert not any(is_loopback(host) for host in ("0.0.0.0", "::", "192.168.1.7", "hand"))
