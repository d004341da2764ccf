"""Many boards through two routers of zenoh: losses over cut links, delays, bytes of each board."""
