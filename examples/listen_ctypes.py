"""Print the kind of each fresh slip with libtactiled and ctypes: ``python listen_ctypes.py ENDPOINT``."""

import ctypes
import sys

MESSAGE = 1  # TACTILED_MESSAGE of tactiled.h

tactiled = ctypes.CDLL("libtactiled.so.0")
tactiled.tactiled_open.restype = ctypes.c_void_p
tactiled.tactiled_text.restype = tactiled.tactiled_error.restype = ctypes.c_char_p
tactiled.tactiled_age_s.restype = ctypes.c_double
client = ctypes.c_void_p(tactiled.tactiled_open(sys.argv[1].encode(), b"slip", None, None))
while client and (kind := tactiled.tactiled_next(client, ctypes.c_double(-1.0))) >= 0:
    valid = ctypes.c_double()
    is_read = kind == MESSAGE and tactiled.tactiled_number(client, b"valid", ctypes.byref(valid)) == 0
    if (
        is_read
        and valid.value
        and tactiled.tactiled_is_fresh(client)
        and abs(tactiled.tactiled_age_s(client)) < 0.2
    ):
        print(tactiled.tactiled_text(client, b"kind").decode(), flush=True)
sys.exit(tactiled.tactiled_error().decode())
