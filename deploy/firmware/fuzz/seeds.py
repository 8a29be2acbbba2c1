"""Write the wire's golden frames and payloads as libFuzzer's first inputs: ``python fuzz/seeds.py FOLDER``."""

from __future__ import annotations

import json
import sys
from pathlib import Path

GOLDEN = Path(__file__).parents[3] / "tests" / "wire" / "golden"


def main(folder: Path) -> None:
    """One file for each golden payload and frame; the byte before it tells fuzz/decode.c which it is."""
    folder.mkdir(parents=True, exist_ok=True)
    for path in sorted(GOLDEN.glob("*.json")):
        entry = json.loads(path.read_text(encoding="utf-8"))
        for hold in range(4):
            (folder / f"{path.stem}-payload-{hold}").write_bytes(bytes([hold]) + bytes.fromhex(entry["payload_hex"]))
            (folder / f"{path.stem}-frame-{hold}").write_bytes(bytes([4 + hold]) + bytes.fromhex(entry["frame_hex"]))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
