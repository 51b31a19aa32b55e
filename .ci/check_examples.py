"""usage: check_examples.py hands.json: whether `twohands demo` found the hands of the packaged examples."""

import json
import platform
import sys
from pathlib import Path

frames = json.loads(Path(sys.argv[1]).read_text())["frames"]
ranges = [hand["range_m"] for frame in frames for hand in frame["hands"].values() if hand["present"]]
assert len(frames) == 4 and len(ranges) >= 6, f"{len(ranges)} hands in {len(frames)} examples"
mean_cm = 100 * sum(ranges) / len(ranges)
print(f"Python {platform.python_version()}: {len(ranges)} hands, ranges of {mean_cm:.2f} cm on average")
