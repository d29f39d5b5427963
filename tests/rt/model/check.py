#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The model of the handover holds in every interleaving, and each of its wrong variants does not."""
import argparse
import pathlib
import re
import subprocess
import sys
import tempfile

MODEL = pathlib.Path(__file__).resolve().parent / "handover.pml"
# Each variant as its macro, and the promise that it must break.
WRONG = {
    "INDEX_BEFORE_CONTENT": "second==reported",
    "COPY_AFTER_HANDBACK": "second==reported",
    "TWO_SLOTS": "second==reported",
    "NO_LATCH": "robot_is_permitted",
    "LOAD_THEN_STORE": "robot_is_permitted",
    "LATCH_FIRST": "robot_is_permitted",
    "SEQUENCE_IGNORED": "told<reported",
    "SEQUENCE_FORGOTTEN": "told<reported",
}


def explore(variant, cycles):
    """Spin's verdict on the model: (errors, states, the assertion that failed)."""
    with tempfile.TemporaryDirectory() as folder:
        defines = [f"-DCYCLES={cycles}"] + ([f"-D{variant}"] if variant else [])
        subprocess.run(["spin", *defines, "-a", str(MODEL)], cwd=folder, check=True, stdout=subprocess.PIPE)
        subprocess.run(["cc", "-O0", "-w", "-DSAFETY", "-DVECTORSZ=2048", "-o", "pan", "pan.c"], cwd=folder, check=True)
        output = subprocess.run(["./pan", "-m1000000"], cwd=folder, check=True, capture_output=True, text=True).stdout
    if "search depth too small" in output:
        sys.exit(f"{variant or 'the model'}: not every interleaving was reached\n{output}")
    errors = int(re.search(r"errors: (\d+)", output).group(1))
    states = int(float(re.search(r"([\d.e+]+) states, stored", output).group(1)))
    failed = re.search(r"assertion violated (.*?) \(at depth", output)
    return errors, states, re.sub(r"[\s()]", "", failed.group(1)) if failed else ""


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cycles", type=int, default=5, help="decisions (default 5)")
    cycles = parser.parse_args().cycles
    errors, states, failed = explore(None, cycles)
    print(f"{'as built':<22} {states:>10} states  {'holds' if errors == 0 else 'FAILS: ' + failed}")
    is_wrong = errors != 0
    for variant, promise in WRONG.items():
        errors, states, failed = explore(variant, cycles)
        is_rejected = errors != 0 and promise in failed
        is_wrong |= not is_rejected
        verdict = f"rejected: {failed}" if is_rejected else f"NOT REJECTED as it should be: {failed or 'no error'}"
        print(f"{variant:<22} {states:>10} states  {verdict}")
    sys.exit(1 if is_wrong else 0)


if __name__ == "__main__":
    main()
