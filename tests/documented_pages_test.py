#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Runs the commands of a documentation page: those in its fenced blocks, in their order, in a folder of their own, so
that what one writes is there for the next. A fenced block whose first line names a file ("```toml room.toml") is that
file. On a network of its own where the system allows it.

What is not run stands in NOT_RUN with its reason, what is run smaller in SMALLER; an entry that no page needs is a
failure, and so is a page that is neither run nor has all its commands in NOT_RUN, and a link to a file that is not there.

Usage: documented_pages_test.py ROOT BIN [PAGE...]   run these pages
       documented_pages_test.py ROOT BIN --list      what is not run, and why; nothing is run"""
import ctypes
import os
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time

PROGRAM = re.compile(r"(?:\./dev|holdfast[a-z-]*) ")
CLONE_NEWNET, CLONE_NEWUSER = 0x40000000, 0x10000000

RUN = ["README.md", "docs/calibration.md", "docs/camera.md", "docs/dashboard.md", "docs/hardware_setup.md",
       "docs/quick_start.md", "docs/ros2.md", "docs/safety/manual.md", "docs/virtual_or.md"]

CONSOLE = "needs a running daemon: tests/rt/console_process_test.cpp"
OWN = "needs a camera of one's own; the demo starts one"
CHAIN = "minutes of the whole chain against the clock, which docs/quick_start.md runs once"

# Page, beginning of the command, reason.
NOT_RUN = [
    ("README.md", "./dev demo", "run on docs/quick_start.md"),
    ("README.md", "./dev test", "this is part of it"),
    ("docs/dashboard.md", "holdfast console --once", CONSOLE),
    ("docs/dashboard.md", "holdfast console --stop", CONSOLE),
    ("docs/dashboard.md", "holdfast console --arm", CONSOLE),
    ("docs/dashboard.md", "holdfast console --acknowledge", CONSOLE),
    ("docs/dashboard.md", "holdfast console --domain", CONSOLE),
    ("docs/dashboard.md", "holdfast-dashboard --config config/dashboard.toml --ct",
     "needs a CT and serves until ended: tests/rt/dashboard_process_test.cpp"),
    ("docs/quick_start.md", "holdfastd --config holdfastd.toml", OWN),
    ("docs/quick_start.md", "holdfast-guard --config guard.toml", OWN),
    ("docs/quick_start.md", "holdfast console", OWN),
    ("docs/recording.md", "holdfast replay", "needs a daemon's recording: tests/rt/recording_command_test.cpp"),
    ("docs/ros2.md", "holdfast-outlets --config config/outlets.toml --ros2-domain",
     "serves until ended: tests/rt/outlets"),
    ("docs/safety/manual.md", "holdfast-sim reactions", CHAIN),
    ("docs/safety/manual.md", "holdfast-sim kills", CHAIN),
    ("docs/virtual_or.md", "holdfast-sim or --config", "minutes of rendering; smaller on docs/calibration.md"),
    ("docs/virtual_or.md", "holdfast-sim or --pictures", "minutes of rendering"),
    ("docs/virtual_or.md", "holdfast-sim calibration-error", "needs those images: run on docs/calibration.md"),
    ("docs/virtual_or.md", "holdfast-sim marker-error", "needs those images: run on docs/calibration.md"),
    ("docs/virtual_or.md", "holdfast-sim bead-error", "needs those images: tests/sim/room_faults_test.py"),
    ("docs/virtual_or.md", "holdfast-sim registration-error", "needs those images: run on docs/calibration.md"),
    ("docs/virtual_or.md", "holdfast-sim calibration-study", "minutes"),
    ("docs/virtual_or.md", "holdfast-sim marker-study", "minutes"),
    ("docs/virtual_or.md", "holdfast demo --setup", "minutes: tests/rt/study_test.py runs it smaller"),
    ("docs/virtual_or.md", "holdfastd --config holdfastd.toml --check", "needs that set-up"),
    ("docs/virtual_or.md", "holdfast track", "needs that set-up"),
]

# Page, what stands there, what is run instead: the same work, less of it.
SMALLER = [
    ("docs/calibration.md", "zoom_first = 1.1\nzoom_last = 1.5\nzoom_count = 5\npairs = 19",
     "zoom_first = 1.2\nzoom_last = 1.2\nzoom_count = 1\npairs = 6"),
    ("docs/calibration.md", "or_light = 0.35", "or_light = 0"),
    ("docs/calibration.md", "--phantom ear --seed 1 --out ct/",
     "--phantom ear --seed 1 --pixel-mm 0.5 --slice-mm 0.75 --out ct/"),
    ("docs/hardware_setup.md", "--seconds 60 --load 2", "--seconds 1 --load 1 --allow-non-rt"),
    ("docs/quick_start.md", "./dev demo", "./dev demo --quick"),
    ("docs/safety/manual.md", "--runs 200 --fault-free-hours 0.5", "--runs 5 --fault-free-hours 0.001"),
]

# Page, what its reader has done before.
BEFORE = [("docs/dashboard.md", "holdfast keys --out config/keys"), ("docs/ros2.md", "holdfast keys --out config/keys")]

# Beginning of a command, other exit codes that are an answer, why.
ALSO_GOOD = [("holdfast doctor", {1}, "a test machine may lack what a control PC has")]

# Beginning of a command that serves until it is interrupted, the word that it says when it does.
SERVES = [("holdfast-sim camera", "ready")]

BEHIND_DEV = {"demo": "holdfast demo", "faults": "holdfast-fault"}
DONE_AFTER_S = 300


def commands_in(block):
    """One a line, with what a backslash continues; comments and other programs left out."""
    lines = iter(block.splitlines())
    for line in lines:
        while line.endswith("\\"):
            line = line[:-1] + next(lines, "")
        line = re.sub(r"^\s*\$ ", "", line).split("  #")[0].strip()
        if PROGRAM.match(line):
            yield line


def steps_of(text):
    """("file", name, content) and ("run", command, None) in the order of the page."""
    for language, name, block in re.findall(r"^```(\w*)(?: +(\S+))?\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
        if name:
            yield "file", name, block
        elif language in ("", "sh"):
            for command in commands_in(block):
                yield "run", command, None


def enter_private_network():
    """As tests/sim/private_network.cpp: loopback only; where it is refused, the host's."""
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.unshare(CLONE_NEWNET if os.geteuid() == 0 else CLONE_NEWNET | CLONE_NEWUSER) != 0:
        return
    subprocess.run(["ip", "link", "set", "lo", "up"], check=True)


class Pages:
    def __init__(self, root, programs):
        self.root, self.programs = root, programs
        self.used, self.problems = set(), []

    def text_of(self, page):
        text = (self.root / page).read_text(encoding="utf-8")
        for entry in SMALLER:
            if entry[0] == page:
                if entry[1] in text:
                    self.used.add(entry)
                text = text.replace(entry[1], entry[2])
        return text

    def reason_not_to(self, page, command):
        for entry in NOT_RUN:
            if entry[0] == page and command.startswith(entry[1]):
                self.used.add(entry)
                return entry[2]
        return None

    def pages(self):
        paths = [self.root / "README.md", *sorted((self.root / "docs").rglob("*.md"))]
        return [str(path.relative_to(self.root)) for path in paths]

    def list(self):
        """Every page's commands are run or said not to be; nothing is said in vain."""
        count = 0
        for page in self.pages():
            for kind, command, _ in steps_of(self.text_of(page)):
                if kind != "run":
                    continue
                reason = self.reason_not_to(page, command)
                if reason:
                    print(f"not run: {page}: {command}: {reason}")
                elif page in RUN:
                    count += 1
                else:
                    self.problems.append(f"{page}: '{command}' is neither run nor in NOT_RUN")
            self.look_at_links(page)
        print(f"{count} commands are run")
        for entry in [*NOT_RUN, *SMALLER]:
            if entry not in self.used:
                self.problems.append(f"{entry[0]}: no command '{entry[1]}' stands there")
        if count < 20:
            self.problems.append(f"only {count} commands are run")

    def look_at_links(self, page):
        for target in re.findall(r"\]\(([^)#\s]+)", (self.root / page).read_text(encoding="utf-8")):
            if "://" not in target and not ((self.root / page).parent / target).exists():
                self.problems.append(f"{page}: links to {target}, which is not there")

    def run(self, page):
        with tempfile.TemporaryDirectory(prefix="holdfast-page-") as name:
            folder = pathlib.Path(name)
            shutil.copytree(self.root / "config", folder / "config")
            steps = [("run", command, None) for at, command in BEFORE if at == page]
            for kind, what, content in [*steps, *steps_of(self.text_of(page))]:
                if kind == "file":
                    (folder / what).write_text(content, encoding="utf-8")
                elif not self.reason_not_to(page, what) and not self.is_done(page, what, folder):
                    return

    def is_done(self, page, command, folder):
        words = command
        if command.startswith("./dev "):
            subcommand, _, rest = command.removeprefix("./dev ").partition(" ")
            words = f"{BEHIND_DEV[subcommand]} {rest}"
        environment = dict(os.environ, PATH=f"{self.programs}:{os.environ['PATH']}",
                           CYCLONEDDS_URI=f"file://{self.root}/config/cyclonedds-local.xml")
        began = time.monotonic()
        process = subprocess.Popen(words, shell=True, executable="/bin/bash", cwd=folder, env=environment,
                                   stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                                   text=True, start_new_session=True)
        served = ""
        for start, word in SERVES:
            while command.startswith(start) and word not in served:
                line = process.stdout.readline()
                if not line:
                    break
                served += line
            if word in served:
                os.killpg(process.pid, signal.SIGINT)
        try:
            output, _ = process.communicate(timeout=DONE_AFTER_S)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)  # the group that it began
            output, _ = process.communicate()
        print(f"{page}: {time.monotonic() - began:6.1f} s  {command}", flush=True)
        output = served + output
        good = {0}.union(*(codes for start, codes, _ in ALSO_GOOD if command.startswith(start)))
        if process.returncode in good:
            return True
        self.problems.append(f"{page}: '{command}' (run as '{words}') ended with {process.returncode}:\n{output[-2000:]}")
        return False


def main():
    root, programs = (pathlib.Path(a).resolve() for a in sys.argv[1:3])
    pages = Pages(root, programs)
    if sys.argv[3:] == ["--list"]:
        pages.list()
    else:
        enter_private_network()
        for page in sys.argv[3:] or RUN:
            pages.run(page)
    for problem in pages.problems:
        print(problem, file=sys.stderr)
    return 1 if pages.problems else 0


if __name__ == "__main__":
    sys.exit(main())
