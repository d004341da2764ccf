"""The measured trades: `./run bench NAME`; not part of the installed package."""
