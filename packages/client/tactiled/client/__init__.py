"""Client for grasp controllers: tactile events as they happen, with their age and with notice of losses.

Needs pyzmq and msgpack only. ::

    from tactiled.client import Client, SlipMessage, Stale

    async with Client("tcp://127.0.0.1:9872", topics=("slip",)) as client:
        async for item in client:
            match item:
                case SlipMessage(data=slip):
                    if client.fresh and slip["valid"] and slip["state"] == "onset" and abs(item.age_s) < 0.2:
                        tighten()
                case Stale(reason=reason):
                    hold_without_touch(reason)

`age_s` of any message is the age of its evidence, so that it is right for every topic; the onset of a slip
lies further back (`onset_age_s`). `Recovered` has a message that was missed and requested again, so it is
old. `Lost` counts messages that cannot be recovered. Commands to the daemon:
``AsyncCommander().send("inhibit", duration_s=0.4)``, and ``announce_motion`` for the hand's own acceleration.

`GripController` turns `grip` messages into the force to grip with.

Without asyncio: `Subscription`, whose `next_item` waits for a limited time, and `Commander`.
"""

from tactiled.client.commander import AsyncCommander, Commander, Reply
from tactiled.client.grip_controller import GripController
from tactiled.client.items import Fresh, Item, Lost, Malformed, Message, Recovered, Restarted, Stale
from tactiled.client.subscriber import Client, Subscription
from tactiled.client.typed import (
    CommandMessage,
    ContactMessage,
    ForceMessage,
    GripMessage,
    InfoMessage,
    RecordingMessage,
    ScanMessage,
    SlipMessage,
    StatusMessage,
    TextureMessage,
    Topic,
)
from tactiled.events.endpoints import DEFAULT_ENDPOINT

__all__ = [
    "DEFAULT_ENDPOINT",
    "AsyncCommander",
    "Client",
    "CommandMessage",
    "Commander",
    "ContactMessage",
    "ForceMessage",
    "Fresh",
    "GripController",
    "GripMessage",
    "InfoMessage",
    "Item",
    "Lost",
    "Malformed",
    "Message",
    "RecordingMessage",
    "Recovered",
    "Reply",
    "Restarted",
    "ScanMessage",
    "SlipMessage",
    "Stale",
    "StatusMessage",
    "Subscription",
    "TextureMessage",
    "Topic",
]
