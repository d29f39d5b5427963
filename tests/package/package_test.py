#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The Debian packages, tried out: what they hold, that a clean Debian 12 takes them with nothing but
what they ask for, that the installed programs run there, and that a robot controller builds against
the installed client alone. One line a check; the first that fails ends it."""
import argparse
import os
import pathlib
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request

PROGRAMS = ["holdfast", "holdfastd", "holdfast-guard", "holdfast-dashboard", "holdfast-outlets"]
UNITS = ["holdfastd.service", "holdfast-guard.service", "holdfast-outlets.service"]
EXPOSURE_MAX = 3.0  # systemd-analyze security, of 10


def fail(what):
    sys.exit(f"package: FAILED: {what}")


def passed(what):
    print(f"package: {what}", flush=True)


def run(words, code=0, **more):
    done = subprocess.run(words, capture_output=True, text=True, check=False, **more)
    if done.returncode != code:
        fail(f"{' '.join(map(str, words))}: exit code {done.returncode}, not {code}:\n"
             f"{done.stdout[-2000:]}{done.stderr[-2000:]}")
    return done.stdout + done.stderr


def find(folder, name):
    found = sorted(folder.glob(f"{name}_*.deb"))
    if len(found) != 1:
        fail(f"{folder}: {len(found)} packages {name}_*.deb, not one")
    return found[0].resolve()


def check_content(deb, client):
    listed = run(["dpkg-deb", "--contents", deb])
    wanted = ([f"./usr/bin/{p}" for p in PROGRAMS] + [f"./usr/lib/systemd/system/{u}" for u in UNITS] +
              [f"./usr/share/man/man1/{p}.1.gz" for p in [*PROGRAMS, "holdfast-hand-eye"]] +
              ["./etc/holdfast/holdfastd.toml", "./etc/holdfast/guard.toml", "./etc/holdfast/outlets.toml",
               "./etc/holdfast/cyclonedds.xml",
               "./usr/share/holdfast/dashboard/index.html", "./usr/share/bash-completion/completions/holdfast",
               "./usr/share/doc/holdfast/copyright"])
    of_client = run(["dpkg-deb", "--contents", client])
    missing = [w for w in wanted if f" {w}\n" not in listed]
    missing += [w for w in ("./usr/include/holdfast/client.hpp", "./usr/share/holdfast/holdfast.idl")
                if f" {w}\n" not in of_client]
    if missing:
        fail(f"not in the packages: {', '.join(missing)}")
    if "holdfast-sim" in listed:
        fail("the simulator is in the package")
    fields = run(["dpkg-deb", "--field", deb, "Depends"])
    for library in ("libddsc0debian", "libaravis-0.8-0", "libopencv-core406", "adduser"):
        if library not in fields:
            fail(f"Depends lacks {library}: {fields}")
    passed(f"{deb.name} {deb.stat().st_size / 1e6:.1f} MB, {client.name} {client.stat().st_size / 1e6:.1f} MB: "
           f"{len(wanted)} files as they should be")


def check_units(prefix):
    # The targets that the units refer to are systemd's own: of this machine.
    shutil.copytree("/usr/lib/systemd/system", prefix / "usr/lib/systemd/system", symlinks=True, dirs_exist_ok=True)
    for unit in UNITS:
        path = prefix / "usr/lib/systemd/system" / unit
        said = run(["systemd-analyze", f"--root={prefix}", "--man=no", "verify", unit])
        ours = [line for line in said.splitlines() if "holdfast" in line]
        if ours:
            fail(f"systemd-analyze verify {unit}: {ours}")
        said = run(["systemd-analyze", "--offline=true", f"--threshold={EXPOSURE_MAX * 10:.0f}", "security", path])
        passed(f"{unit}: {said.strip().splitlines()[-1].split(': ', 1)[-1]}")


def check_client(work, client, source):
    prefix = work / "client"
    run(["dpkg-deb", "-x", client, prefix])
    run(["cmake", "-S", source / "bridge/client/example", "-B", work / "robot", "-G", "Ninja",
         f"-DCMAKE_PREFIX_PATH={prefix}/usr", "-DCMAKE_BUILD_TYPE=Release"])
    if f"{prefix}/usr" not in (work / "robot/CMakeCache.txt").read_text():
        fail("find_package(holdfast_client) found another one")
    run(["cmake", "--build", work / "robot"])
    passed("a robot controller builds against the installed client alone")


class Root:
    """A Debian 12 with nothing in it but its essential packages, and what ours ask for."""

    def __init__(self, work, deb):
        self.path = work / "root"
        run(["mmdebstrap", "--variant=essential", "--mode=root", "--aptopt=Apt::Install-Recommends false",
             "--aptopt=Acquire::Languages none", f"--include={deb}",
             "--dpkgopt=force-unsafe-io", "--dpkgopt=path-exclude=/usr/share/locale/*",
             "--dpkgopt=path-exclude=/usr/share/doc/*", "--hook-dir=/usr/share/mmdebstrap/hooks/file-mirror-automount",
             "bookworm", self.path])

    def words(self, *words, user=None):
        as_user = ["setpriv", f"--reuid={user}", "--regid=holdfast", "--clear-groups", "--no-new-privs"] if user else []
        # /proc in a mount namespace of its own: nothing is left mounted, however this ends.
        with_proc = 'mount --bind /proc "$0/proc" && exec chroot "$0" "$@"'
        return ["unshare", "--mount", "sh", "-c", with_proc, self.path, *as_user, *words]

    def run(self, *words, code=0, user=None):
        return run(self.words(*words, user=user), code=code, env={"PATH": "/usr/sbin:/usr/bin:/sbin:/bin"})


def check_installed(root):
    for program in PROGRAMS:
        if root.run(program, "--version").strip() != "0.1.0":
            fail(f"{program} --version")
    passed("all programs run where only the package and what it depends on is installed")
    for user in ("holdfast", "holdfast-guard", "holdfast-outlets"):
        root.run("id", user)
    # The example configuration names no keys, camera or registration that exist: it must not start.
    said = root.run("holdfastd", "--config", "/etc/holdfast/holdfastd.toml", "--check", code=2, user="holdfast")
    if said.count("\n") != 1:
        fail(f"not one line: {said}")
    passed(f"the daemon refuses its example configuration: {said.strip()}")


def check_started(root):
    """Guard, dashboard and outlets as users of their own, on the loopback, without keys by explicit permission."""
    config = root.path / "etc/holdfast"
    unsecured = 'allow_unsecured = true\n'
    guard = (config / "guard.toml").read_text().replace('security = "keys/guard"', unsecured)
    (config / "try-guard.toml").write_text(guard.replace("allow_non_rt = false", "allow_non_rt = true"))
    (config / "try-dashboard.toml").write_text(f"domain = 229\n[dds]\n{unsecured}")
    (config / "try-outlets.toml").write_text(f"domain = 229\n[dds]\n{unsecured}[openigtlink]\non = true\n")
    loopback = ("<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo'/></Interfaces>"
                "<AllowMulticast>false</AllowMulticast></General></Domain></CycloneDDS>")
    environment = {"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "CYCLONEDDS_URI": loopback}
    port = 18231
    started = {
        "holdfast-guard": ["holdfast-guard", "--config", "/etc/holdfast/try-guard.toml", "--domain", "229"],
        "holdfast-dashboard": ["holdfast-dashboard", "--config", "/etc/holdfast/try-dashboard.toml", "--port", str(port)],
        "holdfast-outlets": ["holdfast-outlets", "--config", "/etc/holdfast/try-outlets.toml"],
    }
    processes = {name: subprocess.Popen(root.words(*words, user="holdfast-guard"), env=environment,
                                        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
                 for name, words in started.items()}
    try:
        page = wait_for_page(f"http://127.0.0.1:{port}/", processes["holdfast-dashboard"])
        if "Holdfast" not in page:
            fail(f"the dashboard answers something else: {page[:200]}")
        for name, process in processes.items():
            if process.poll() is not None:
                fail(f"{name} ended by itself: {process.stderr.read()[-500:]}")
    finally:
        codes = {}
        for name, process in processes.items():
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
        for name, process in processes.items():
            codes[name] = process.wait(timeout=20)
    if any(codes.values()):
        fail(f"ended on SIGTERM with {codes}, not 0")
    passed("guard, dashboard and outlets start as their own user, serve, and end on SIGTERM with 0")


def wait_for_page(address, process):
    end = time.monotonic() + 30
    while time.monotonic() < end and process.poll() is None:
        try:
            with urllib.request.build_opener(urllib.request.ProxyHandler({})).open(address, timeout=2) as answer:
                return answer.read().decode()
        except OSError:
            time.sleep(0.1)  # between two questions
    fail(f"the dashboard does not answer: {process.stderr.read()[-500:] if process.poll() is not None else 'silent'}")
    return ""


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--packages", type=pathlib.Path, required=True)
    parser.add_argument("--source", type=pathlib.Path, required=True)
    parser.add_argument("--no-root", action="store_true", help="leave the clean root out: it takes minutes")
    args = parser.parse_args()
    deb, client = find(args.packages, "holdfast"), find(args.packages, "holdfast-client-dev")
    check_content(deb, client)
    work = pathlib.Path(tempfile.mkdtemp(prefix="holdfast-package-"))
    try:
        run(["dpkg-deb", "-x", deb, work / "unpacked"])
        check_units(work / "unpacked")
        check_client(work, client, args.source.resolve())
        if args.no_root:
            passed("not tried in a clean root, as asked (./dev package does)")
            return
        if os.geteuid() != 0:
            passed("NOT TRIED in a clean root: needs root")
            return
        os.chmod(work, 0o755)
        root = Root(work, deb)
        passed("a clean Debian 12 takes the package with what it depends on")
        check_installed(root)
        check_started(root)
    finally:
        shutil.rmtree(work, ignore_errors=True)
    passed("all checks passed")


if __name__ == "__main__":
    main()
