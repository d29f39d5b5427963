#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The control loop under Debian's PREEMPT_RT kernel in virtual time: what it may not do, it is caught doing.

In one guest: the loop alone, the loop under hackbench, and five loops with a planted fault each (malloc,
page touch, lock without priority inheritance, printf, drifting grid), all of which must be caught; and the
microscope on vcan (classic and FD) and on two emulated SJA1000 controllers. In a second guest, with Debian's
ordinary kernel: the loop under hackbench, which must fail, or the measurement could not tell the two apart.
In three more the guard strokes the machine's watchdog: a machine whose guard ends in order lives on, one whose
guard is killed, or whose robot is enabled against it, is reset.

It shows logic, locking and instruction counts on the kernel that the robot PC runs, not that PC's hardware.

Example: rtvm.py --bin build/release/bin --json rtvm.json
Exit code: 0 all as required; 1 not, the reasons on stderr; 3 QEMU or a kernel package is not there."""
import argparse
import json
import os
import pathlib
import sys
import tempfile
from xml.etree import ElementTree

import guest
import kernel_image

HERE = pathlib.Path(__file__).resolve().parent
MUTANTS = {  # what must be among the findings
    "malloc": "allocations", "page_touch": "page_faults", "mutex": "missed", "printf": "system_calls",
    "grid_drift": "missed"}
CAN = {  # bus: what must be 1 on it
    "can_vcan": ("optics_known", "receive_overflow", "error_passive", "bus_off", "bus_off_stays", "interface_down"),
    "can_vcan_fd": ("optics_known", "receive_overflow", "error_passive", "bus_off", "bus_off_stays", "interface_down"),
    "can_sja1000": ("optics_known", "receive_overflow", "queue_filled", "transmit_queue_full")}
CAN_COMMANDS, CONFIRM_MAX_MS, MISSING_MAX_MS = 200, 5, 40  # 40 ms: two heartbeat periods
TOLD_MAX_MS = 25  # a state period, the reader's and the probe's millisecond
WATCHDOG_CASES, WATCHDOG_MAX_S = ("orderly", "killed", "disobeyed"), 4  # its patience is 3 s
# Cycles: quiet, loaded, of each mutant, of the control. A cycle is a millisecond.
SIZES = {"quick": (2000, 800, 300, 800), "full": (600_000, 600_000, 5000, 20_000)}


def boot(options):
    """Exit code and lines of a guest."""
    with tempfile.TemporaryFile("w+") as output:
        saved = os.dup(1)
        os.dup2(output.fileno(), 1)
        try:
            code = guest.boot(options.command, options)
        finally:
            os.dup2(saved, 1)
            os.close(saved)
        output.seek(0)
        return code, output.read().splitlines()


def run_guest(kernel, bin_directory, cycles, timeout):
    """The campaign's lines as a dictionary; raises RuntimeError when the guest did not end well."""
    command = ["bash", str(HERE / "campaign.sh"), str(bin_directory), *map(str, cycles)]
    code, lines = boot(guest.parse(["--kernel", kernel, "--virtual-time", "--timeout", str(timeout), *command]))
    results = {}
    for line in lines:
        name, _, text = line.partition(" ")
        try:
            results[name] = json.loads(text)
        except json.JSONDecodeError:
            print(f"guest: {line}", file=sys.stderr)
    if code != 0:
        raise RuntimeError(f"the {kernel} guest ended with exit code {code}")
    return results


def watchdog_case(name, bin_directory):
    """Seconds that the machine lived on after what happened to its guard, and whether it was reset then."""
    command = ["bash", str(HERE / "watchdog.sh"), str(bin_directory), name]
    code, lines = boot(guest.parse(["--virtual-time", "--timeout", "600", *command]))
    values = dict(line.split() for line in lines if len(line.split()) == 2)
    if "guarded_s" not in values or code not in (0, guest.DIED):
        raise RuntimeError(f"the guest of watchdog.sh {name} ended with exit code {code}: {' | '.join(lines)}")
    return {"alive_s": int(values.get("alive_s", 0)), "is_reset": code == guest.DIED}


def failures_of(results, name):
    return results.get(name, {}).get("failures", ["no result"])


def summarise(rt, plain, watchdog):
    caught = [name for name, finding in MUTANTS.items() if finding in failures_of(rt, f"mutant_{name}")]
    return {
        "kernel": rt["kernel"], "cycles": rt["quiet"]["cycles"] + rt["loaded"]["cycles"],
        "missed": rt["quiet"]["missed"] + rt["loaded"]["missed"],
        "wake_us_max": max(rt["quiet"]["wake_us_max"], rt["loaded"]["wake_us_max"]),
        "body_us_p50": rt["quiet"]["body_us_p50"], "body_us_max": rt["quiet"]["body_us_max"],
        "wake_floor_us_max": rt["floor_us_max"],
        "control_kernel": plain["kernel"],
        "control_kernel_failed": bool({"wake", "missed"} & set(failures_of(plain, "loaded"))),
        "mutants_caught": len(caught), "mutants": len(MUTANTS),
        "mutants_missed": sorted(set(MUTANTS) - set(caught)),
        "can": {
            "confirm_ms_p99": max(rt[bus]["confirm_ms_p99"] for bus in CAN),
            "node_never_seen_ms": max(rt[bus]["never_seen_ms"] for bus in CAN),
            "node_fell_silent_ms": max(rt[bus]["fell_silent_ms"] for bus in CAN),
            "reader_tells_zoom_ms": max(rt[bus]["reader_tells_zoom_ms"] for bus in CAN),
            "reader_misses_ms": max(rt[bus]["reader_misses_ms"] for bus in CAN)},
        "watchdog": watchdog,
        "runs": {"rt": rt, "control": plain}}


def can_problem(rt, bus):
    """What is not as required on this bus, or None."""
    seen = rt[bus]
    wrong = [key for key in CAN[bus] if seen.get(key) != 1]
    if seen["commands_confirmed"] != CAN_COMMANDS or seen["confirm_ms_p99"] > CONFIRM_MAX_MS:
        wrong.append("confirmation")
    if not all(0 <= seen[key] <= MISSING_MAX_MS for key in ("never_seen_ms", "fell_silent_ms")):
        wrong.append("missing node")
    if not 0 <= seen["reader_misses_ms"] <= MISSING_MAX_MS or not 0 <= seen["reader_tells_zoom_ms"] <= TOLD_MAX_MS:
        wrong.append("the daemon's reader")
    return f"{bus}: {', '.join(wrong)}: {json.dumps(seen)}" if wrong else None


def watchdog_problem(seen):
    if not seen["is_reset"]:
        return "it was not reset"
    return f"only after {seen['alive_s']} s" if seen["alive_s"] > WATCHDOG_MAX_S else None


def checks(rt, result):
    """Name, requirement and problem (None: as required) of each thing that must be so."""
    def clean(name, *wanted):
        bad = sorted(set(failures_of(rt, name)) & set(wanted) | set(failures_of(rt, name)) & {"died", "no result"})
        return f"{name}: {', '.join(bad)}: {json.dumps(rt.get(name))}" if bad else None
    forbidden = ("allocations", "locks", "page_faults", "system_calls")
    return [
        ("KeepsItsGridAlone", "SR-78", clean("quiet", "missed", "wake", "not_permitted")),
        ("KeepsItsGridUnderHackbench", "SR-78", clean("loaded", "missed", "wake", "not_permitted")),
        ("MakesNoCallThatMayWait", "SR-77", clean("quiet", *forbidden) or clean("loaded", *forbidden)),
        ("CatchesEveryMutant", "SR-77,SR-78", None if result["mutants_caught"] == result["mutants"] else
         f"not caught: {', '.join(result['mutants_missed'])}"),
        *((f"Microscope{bus.removeprefix('can_').title().replace('_', '')}", "SR-91,SR-93,SR-95,SR-108", can_problem(rt, bus))
          for bus in CAN),
        ("MachineLivesOnWhenTheGuardEndsInOrder", "SR-144",
         None if not result["watchdog"]["orderly"]["is_reset"] else "it was reset"),
        *((f"MachineIsResetWhenTheGuardIs{name.title()}", "SR-144", watchdog_problem(result["watchdog"][name]))
          for name in ("killed", "disobeyed")),
        ("ControlKernelFails", "SR-78", None if result["control_kernel_failed"] else
         f"the ordinary kernel passed: {json.dumps(result['runs']['control'].get('loaded'))}")]


def write_whole(path, text):
    partial = pathlib.Path(f"{path}.partial")
    partial.parent.mkdir(parents=True, exist_ok=True)
    partial.write_text(text, encoding="utf-8")
    os.replace(partial, path)


def write_xml(path, outcomes):
    """As GoogleTest would: tests/safety/trace.py reads it."""
    suite = ElementTree.Element("testsuite", name="Rtvm")
    for name, requirement, problem in outcomes:
        case = ElementTree.SubElement(suite, "testcase", classname="Rtvm", name=name, status="run")
        properties = ElementTree.SubElement(case, "properties")
        ElementTree.SubElement(properties, "property", name="requirement", value=requirement)
        if problem:
            ElementTree.SubElement(case, "failure", message=problem)
    write_whole(path, ElementTree.tostring(suite, encoding="unicode"))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", type=pathlib.Path, required=True, help="folder of the built programs")
    parser.add_argument("--full", action="store_true", help="600,000 cycles alone and 600,000 under load: hours")
    parser.add_argument("--json", type=pathlib.Path, metavar="FILE")
    parser.add_argument("--xml", type=pathlib.Path, metavar="FILE", help="as GoogleTest writes it")
    arguments = parser.parse_args()
    quiet, loaded, mutant, control = SIZES["full" if arguments.full else "quick"]
    timeout = 8 * 3600 if arguments.full else 600
    try:
        bin_directory = arguments.bin.resolve(strict=True)
        rt = run_guest("rt", bin_directory, (quiet, loaded, mutant), timeout)
        plain = run_guest("plain", bin_directory, (0, control, 0), timeout)
        watchdog = {name: watchdog_case(name, bin_directory) for name in WATCHDOG_CASES}
        result = summarise(rt, plain, watchdog)
    except kernel_image.Unavailable as missing:
        print(missing, file=sys.stderr)
        return 3
    except (RuntimeError, KeyError, OSError) as error:
        print(f"rtvm: {error!r}", file=sys.stderr)
        return 1
    outcomes = checks(rt, result)
    if arguments.xml:
        write_xml(arguments.xml, outcomes)
    problems = [f"rtvm: {name}: {problem}" for name, _, problem in outcomes if problem]
    for problem in problems:
        print(problem, file=sys.stderr)
    print(json.dumps({key: value for key, value in result.items() if key != "runs"}, indent=2))
    if arguments.json:
        write_whole(arguments.json, json.dumps(result, indent=2) + "\n")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
