"""``python -m tactiled``."""

from tactiled.cli import main

main()
