"""Recomputes every key of a store from the stored actions: python3 recompute_keys.py STORE. Needs the package blake3.

Shares no code with marf: it reads the packs as docs/design/packs-and-records.md describes them.
"""
import json
import pathlib
import struct
import sys

import blake3

blobs, records = {}, {}
for pack in pathlib.Path(sys.argv[1], "packs").glob("*.pack"):
    data = pack.read_bytes()
    assert data[:12] == b"marf-pack-2\n" and data[-12:] == b"marf-pend-2\n", pack
    at, (table,) = 12, struct.unpack("<Q", data[-52:-44])
    while at < table:
        kind, ident, length = struct.unpack("<B32sI", data[at : at + 37])
        payload = data[at + 37 : at + 37 + length]
        at += 37 + length
        if kind == 0:
            blobs[ident.hex()] = payload
        elif kind == 1:  # checksum, generation, JSON
            records[ident.hex()] = json.loads(payload[36:])
for loose in pathlib.Path(sys.argv[1], "cas").glob("*/*"):
    blobs[loose.parent.name + loose.name] = loose.read_bytes()

assert records, f"no record of a store in {sys.argv[1]}"
for key, record in sorted(records.items()):
    action = blobs[key]
    assert blake3.blake3(action).hexdigest() == key == record["key"], key
    told = json.loads(action)
    assert told["stage"] == record["stage"], key
    canonical = json.dumps(told, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    assert json.loads(canonical) == told and list(told) == sorted(told), key
    print(key, told["stage"], told.get("part", ""), told.get("shard", ""))
print(f"{len(records)} keys, each the blake3 of its action")
