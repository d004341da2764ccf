"""What a grasp controller imports: tactile events as they happen, and the truth about their age.

Needs pyzmq and msgpack only. ::

    from tactiled.client import Client, Fresh, Lost, Message, Stale

    async with Client("tcp://127.0.0.1:9872", topics=("slip",)) as client:
        async for item in client:
            match item:
                case Message(topic="slip"):
                    if client.fresh and item.data["state"] == "onset": tighten()
                case Stale(reason=reason):
                    hold_without_touch(reason)

or, without asyncio, ``for item in subscribe("tcp://127.0.0.1:9872", topics=("slip",)): ...``
"""

from tactiled.client.inbox import Fresh, Item, Lost, Malformed, Message, Restarted, Stale
from tactiled.client.subscriber import DEFAULT_ENDPOINT, Client, Subscription, subscribe

__all__ = [
    "DEFAULT_ENDPOINT",
    "Client",
    "Fresh",
    "Item",
    "Lost",
    "Malformed",
    "Message",
    "Restarted",
    "Stale",
    "Subscription",
    "subscribe",
]
