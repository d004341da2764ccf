"""Bridge to ROS 2: a DDS participant that ROS 2 sees as a node, without any part of ROS.

- `definitions`: types of ROS from ``.msg`` text, their hashes (REP-2011), and those of others that are used
- `own_types`: the types of our messages
- `cdr`: encoding of messages
- `names`: names of topics, types and frames
- `freshness`: decision which messages may be published
- `convert`: values of ROS messages from messages of the daemon
- `participant`: topics and discovery over Cyclone DDS
- `bridge`: the process behind ``tactiled ros2``
"""
