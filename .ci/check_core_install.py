"""Run by core-install.sh in an environment that holds the core of twohands only: what tracking promises, measured."""

import importlib.util
import json
import os
import subprocess
import sys
import tempfile
import time
from importlib import resources
from importlib.metadata import files
from pathlib import Path

MAX_IMPORT_S = 0.5
MAX_TRACK_S = 5.0
MAX_MEMORY_BYTES = 1e9
EXTRAS = (
    "torch",
    "moderngl",
    "bpy",
    "matplotlib",
    "anny",
    "safetensors",
    "onnx",
    "lightning_fabric",
    "starlette",
    "rosbags",
)
REPEATS = 3


def measure(*command: str) -> tuple[float, float]:
    """Seconds and peak resident bytes of a command that must succeed; seconds by the clock or, if it had to wait for a
    processor, those that it got one."""
    start = time.perf_counter()
    process = subprocess.Popen([sys.executable, *command], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    assert os.waitstatus_to_exitcode(status) == 0, f"{command} failed"
    return min(time.perf_counter() - start, usage.ru_utime + usage.ru_stime), usage.ru_maxrss * 1024


def main() -> None:
    present = [name for name in EXTRAS if importlib.util.find_spec(name)]
    assert not present, f"the core install brought {present}"

    assert (resources.files("twohands.visualization") / "view" / "view.js").is_file(), "the view is not in the wheel"
    licences = {path.name for path in files("twohands") or () if "licenses" in path.parts}
    assert licences == {"LICENSE", "NOTICE"}, f"the wheel has the licence files {sorted(licences)}"

    bare = min(measure("-c", "pass")[0] for _ in range(REPEATS))
    import_s = min(measure("-c", "import twohands")[0] for _ in range(REPEATS)) - bare
    image = sorted(Path(str(resources.files("twohands") / "examples_data")).glob("*.[pj][np]g"))[0]
    with tempfile.TemporaryDirectory() as folder:
        runs = []
        for repeat in range(REPEATS):
            out = Path(folder) / str(repeat)
            runs.append(measure("-m", "twohands.cli.main", "track", str(image), "--out", str(out)))
            frame = json.loads((out / "hands.json").read_text())["frames"][0]
        found = [side for side, hand in frame["hands"].items() if hand["present"]]
    track_s, memory = min(seconds for seconds, _ in runs), max(size for _, size in runs)
    first_s = runs[0][0]
    print(
        f"core install: import {import_s:.2f} s, track {track_s:.1f} s (first {first_s:.1f} s), {memory / 1e6:.0f} MB"
    )
    print(f"hands found in {image.name}: {', '.join(found) or 'none'}")
    assert found, "the example image shows hands"
    assert import_s < MAX_IMPORT_S, f"import takes {import_s:.2f} s, expected under {MAX_IMPORT_S} s"
    assert track_s < MAX_TRACK_S, f"track takes {track_s:.1f} s, expected under {MAX_TRACK_S} s"
    assert memory < MAX_MEMORY_BYTES, f"track needs {memory / 1e6:.0f} MB, expected under {MAX_MEMORY_BYTES / 1e6:.0f}"


if __name__ == "__main__":
    main()
