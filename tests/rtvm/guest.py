#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Runs a command under Debian's PREEMPT_RT kernel (or the ordinary one) in QEMU, as root.

  guest.py [--kernel rt|plain] [--virtual-time] [--memory MIB] [--timeout S] [--log FILE] COMMAND [ARGUMENT...]

The guest sees this machine's files, read-only; what it writes is thrown away. The command runs in the
caller's directory; what it prints comes out here.

--virtual-time  one CPU whose clock is its instruction counter: one instruction takes one nanosecond, idle
                time is skipped. What happens then does not depend on how busy this machine is, and repeats.
                It shows logic, locking and instruction counts; it says nothing about a real CPU's caches,
                buses, firmware or interrupts.
Without it the guest has two CPUs and wall-clock time of no quality.

In the guest: loopback network with multicast; vcan0 (CAN FD), can0 and can1 (two emulated SJA1000
controllers on one bus; down); /dev/watchdog (i6300esb: not stroked, it resets, and the guest dies); modprobe
for the rest of the kernel package; HOLDFAST_GUEST=rt|plain in the environment.

Exit code: the command's; 3 QEMU, a tool or the kernel package is not there; 124 --timeout passed (seconds of
wall clock, default 300); 125 the guest died. Environment: HOLDFAST_RTVM_CACHE, see kernel_image.py."""
import argparse
import os
import pathlib
import shlex
import shutil
import subprocess
import sys
import tempfile
import threading

import kernel_image

TIMED_OUT, DIED = 124, 125

SCRIPT = """\
export PATH={path} HOME=/root LANG=C.UTF-8 HOLDFAST_GUEST={kind}
ip link set lo up multicast on
ip route add 224.0.0.0/4 dev lo
modprobe -a vcan can-raw kvaser_pci i6300esb
ip link add vcan0 type vcan
ip link set vcan0 mtu 72 up
for port in /sys/class/virtio-ports/*; do declare "$(cat "$port/name")=/dev/${{port##*/}}"; done
cd {directory}
{command} > "$output" 2>&1 < /dev/null
echo $? > "$status"
sync
echo o > /proc/sysrq-trigger
sleep 60
"""


def qemu_command(image, run_directory, output_fd, options):
    time = ["-smp", "2"]
    if options.virtual_time:
        time = ["-smp", "1", "-icount", "shift=0,sleep=off", "-rtc", "clock=vm"]
    arguments = [
        "console=ttyS0", "quiet", "loglevel=4", "panic=-1", "mitigations=off", "random.trust_cpu=on",
        "tsc=reliable", f"holdfast.script={run_directory}/script", f"holdfast.modules={image}/package/lib/modules/"
        + (image / "version").read_text()]
    return [
        "qemu-system-x86_64", "-machine", "q35,accel=tcg", "-cpu", "max", "-m", str(options.memory), *time,
        "-nodefaults", "-no-user-config", "-display", "none", "-no-reboot",
        "-kernel", str(image / "kernel"), "-initrd", str(image / "initrd"), "-append", " ".join(arguments),
        "-chardev", f"file,id=log,path={run_directory}/kernel.log", "-serial", "chardev:log",
        "-device", "virtio-serial-pci",
        "-chardev", f"file,id=output,path=/dev/fd/{output_fd}", "-device", "virtserialport,chardev=output,name=output",
        "-chardev", f"file,id=status,path={run_directory}/status", "-device", "virtserialport,chardev=status,name=status",
        "-fsdev", "local,id=host,path=/,security_model=none,readonly=on,multidevs=remap",
        "-device", "virtio-9p-pci,fsdev=host,mount_tag=host",
        "-object", "can-bus,id=bus", "-device", "kvaser_pci,canbus=bus", "-device", "kvaser_pci,canbus=bus",
        "-device", "i6300esb", "-action", "watchdog=reset"]


def copy_output(read_end):
    with os.fdopen(read_end, "rb", buffering=0) as pipe:
        while chunk := pipe.read(65536):
            sys.stdout.buffer.write(chunk)
            sys.stdout.buffer.flush()


def boot(command, options):
    """Runs `command` (a list) in a guest; its exit code, TIMED_OUT or DIED."""
    image = kernel_image.prepare(options.kernel)
    if shutil.which("qemu-system-x86_64") is None:
        raise kernel_image.Unavailable("rtvm: qemu-system-x86_64 is not installed; run ./dev setup")
    with tempfile.TemporaryDirectory(prefix="run.", dir=kernel_image.cache_directory()) as scratch:
        run_directory = pathlib.Path(scratch)
        (run_directory / "script").write_text(SCRIPT.format(
            path=shlex.quote(os.environ["PATH"]), kind=options.kernel, directory=shlex.quote(os.getcwd()),
            command=shlex.join(command)))
        read_end, write_end = os.pipe()
        copier = threading.Thread(target=copy_output, args=(read_end,))
        copier.start()
        process = subprocess.Popen(qemu_command(image, run_directory, write_end, options), stdin=subprocess.DEVNULL,
                                   stdout=sys.stderr, pass_fds=[write_end])
        os.close(write_end)
        try:
            process.wait(timeout=options.timeout)
        except subprocess.TimeoutExpired:
            return TIMED_OUT
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()
            copier.join()
            if options.log:
                shutil.copy(run_directory / "kernel.log", options.log)
        status = (run_directory / "status").read_text().strip() if (run_directory / "status").exists() else ""
        return int(status) if status else DIED


def parse(arguments):
    parser = argparse.ArgumentParser(prog="guest.py", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kernel", choices=["rt", "plain"], default="rt")
    parser.add_argument("--virtual-time", action="store_true")
    parser.add_argument("--memory", type=int, default=1024, metavar="MIB")
    parser.add_argument("--timeout", type=float, default=300, metavar="S")
    parser.add_argument("--log", metavar="FILE", help="the guest's kernel log")
    parser.add_argument("command", nargs=argparse.REMAINDER, metavar="COMMAND")
    options = parser.parse_args(arguments)
    if not options.command:
        parser.error("no command")
    return options


if __name__ == "__main__":
    try:
        chosen = parse(sys.argv[1:])
        sys.exit(boot(chosen.command, chosen))
    except kernel_image.Unavailable as missing:
        print(missing, file=sys.stderr)
        sys.exit(3)
