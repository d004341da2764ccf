"""Generate interface files from the JSON Schemas of the events: ``python -m tools.interfaces`` writes them.

- ``ros2/tactiled_msgs``: the ROS 2 types of ``tactiled ros2``
"""

from pathlib import Path

from tactiled.ros2 import own_types

ROOT = Path(__file__).resolve().parents[1]


def generated() -> dict[str, str]:
    """Return the content of every generated file by its path in the checkout."""
    messages = {f"ros2/tactiled_msgs/msg/{name}.msg": text for name, text in own_types.own_texts().items()}
    services = {
        f"ros2/tactiled_msgs/srv/{name}.srv": text for name, text in own_types.service_texts().items()
    }
    return messages | services


def main() -> None:
    """Write all files that differ."""
    for name, text in generated().items():
        path = ROOT / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
            print(f"{name}: written")


if __name__ == "__main__":
    main()
