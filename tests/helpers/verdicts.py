"""Contacts at an instant, and the sentences of page and terminal about them."""

from typing import Any, NamedTuple

AT_S = 20.0
_ONSET: dict[str, Any] = {
    "state": "onset", "valid": True, "suppressed": "", "direction_deg": 178, "direction_sd_deg": 2,
    "confidence": 0.9, "timestamp": AT_S, "onset": AT_S - 0.4, "detected": AT_S,
}  # fmt: skip
_GRIP: dict[str, Any] = {
    "utilisation": 0.4, "p_gross_100ms": 0.02, "p_sliding": 0.97, "valid": True, "state": "sticking",
    "unit": "relative", "timestamp": AT_S,
}  # fmt: skip


class Case(NamedTuple):
    """State of a contact, fields of its messages that differ from the usual ones, and what is said."""

    contact: str
    slip: dict[str, Any]
    grip: dict[str, Any]
    level: str
    sentence: str
    sure: str

    def messages(self) -> dict[str, dict[str, Any]]:
        """Messages by topic."""
        found = {"contact": {"state": self.contact, "timestamp": AT_S, "taxels": [0]}}
        if self.slip:
            found["slip"] = _ONSET | self.slip
        return found | {"grip": _GRIP | self.grip}


_USED, _LATE = "40 % of the friction limit in use", "The readings were late or incomplete."
_ALL, _PART = "97 % sure that all of the contact slides", "90 % sure that a part of the contact slips"
CASES = [
    Case("none", {}, {"state": "none"}, "free", "Nothing touches the skin", ""),
    Case("loading", {}, {}, "good", "Being pressed", _USED),
    Case("holding", {}, {}, "good", "Holding", _USED),
    Case("holding", {}, {"state": "none"}, "good", "Holding", ""),
    Case("holding", {}, {"utilisation": 0.8}, "near", "Holding near the friction limit: tighten",
         "80 % of the friction limit in use"),
    Case("holding", {}, {"p_gross_100ms": 0.8}, "near", "Holding near the friction limit: tighten",
         "80 % sure that it slips within 0.1 s"),
    Case("holding", {}, {"utilisation": 0.8, "valid": False}, "good", "Holding",
         "80 % of the friction limit in use"),
    Case("unknown", {}, {"state": "unknown"}, "near", "Touching, may hold or slip: lift once",
         "The beginning of this contact was not seen."),
    Case("shearing", {"kind": "incipient"}, {}, "partial", "Beginning to slip towards -x for 0.4 s: tighten",
         _PART),
    Case("sliding", {"kind": "gross"}, {}, "gross", "Slipping towards -x for 0.4 s: tighten", _ALL),
    Case("sliding", {"kind": "gross"}, {"state": "none"}, "gross", "Slipping towards -x for 0.4 s: tighten",
         "90 % sure"),
    Case("holding", {"kind": "gross"}, {"timestamp": AT_S - 0.01}, "gross",  # slip before its contact message
         "Slipping towards -x for 0.4 s: tighten", "90 % sure that all of the contact slides"),
    Case("sliding", {"kind": "gross", "direction_sd_deg": 180}, {}, "gross", "Slipping for 0.4 s: tighten",
         _ALL),
    Case("sliding", {"kind": "gross", "direction_deg": -88, "onset": AT_S - 45}, {}, "gross",
         "Slipping towards -y for 45 s: tighten", _ALL),
    Case("sliding", {"kind": "gross", "onset": AT_S - 300}, {}, "gross",
         "Slipping towards -x for 5 min: tighten", _ALL),
    Case("sliding", {"kind": "gross", "valid": False}, {"valid": False}, "near",
         "Slipping towards -x for 0.4 s: do not act on it", _LATE),
    Case("sliding", {"kind": "gross", "valid": False}, {"state": "none", "valid": False}, "near",
         "Slipping towards -x for 0.4 s: do not act on it", _LATE),
    # Its onset was late, but what is read now can be trusted.
    Case("sliding", {"kind": "gross", "valid": False}, {}, "gross", "Slipping towards -x for 0.4 s: tighten",
         _ALL),
    Case("sliding", {"kind": "gross", "valid": False, "suppressed": "inhibit"}, {}, "good",
         "Slipping towards -x for 0.4 s, as announced (inhibit)", _ALL),
    # The viewer was started later than the onset.
    Case("sliding", {}, {}, "gross", "Slipping: tighten", _ALL),
]  # fmt: skip
