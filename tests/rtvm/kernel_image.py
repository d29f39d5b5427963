# SPDX-License-Identifier: Apache-2.0
"""Debian's kernels made ready to boot in QEMU: package -> kernel, modules, initial ramdisk.

Everything is kept in a cache directory (HOLDFAST_RTVM_CACHE, else ~/.cache/holdfast-rtvm), one folder
a package version, complete or not there. The packages come from the Debian mirror that apt knows, by
`apt-get download`: no root needed, nothing is installed."""
import lzma
import os
import pathlib
import shutil
import subprocess
import tempfile
import zlib

META_PACKAGES = {"rt": "linux-image-rt-amd64", "plain": "linux-image-amd64"}
# What it takes to see this machine's files; the guest loads the rest with modprobe.
BOOT_MODULES = ["virtio_pci", "9pnet_virtio", "9p", "overlay", "virtio_console"]
INIT = pathlib.Path(__file__).parent / "guest_init.sh"


class Unavailable(Exception):
    """A tool or package is not there; the message says which and what to do."""


def cache_directory():
    default = pathlib.Path(os.environ.get("XDG_CACHE_HOME", pathlib.Path.home() / ".cache")) / "holdfast-rtvm"
    return pathlib.Path(os.environ.get("HOLDFAST_RTVM_CACHE", default)).absolute()


def run(*command, **options):
    try:
        return subprocess.run(command, check=True, text=True, stdout=subprocess.PIPE, **options).stdout
    except FileNotFoundError:
        raise Unavailable(f"rtvm: {command[0]} is not installed; run ./dev setup") from None
    except subprocess.CalledProcessError as error:
        raise Unavailable(f"rtvm: {' '.join(map(str, command))} failed with exit code {error.returncode}") from None


def package_name(kind):
    """The package with the kernel itself, which the meta package depends on."""
    for line in run("apt-cache", "depends", META_PACKAGES[kind]).splitlines():
        dependency, _, name = line.strip().partition(": ")
        if dependency == "Depends" and name.startswith("linux-image"):
            return name
    raise Unavailable(f"rtvm: apt knows no {META_PACKAGES[kind]}; run apt-get update")


def uncompressed(vmlinuz):
    """The ELF kernel inside (QEMU enters it directly: half the boot time), or None if it is packed otherwise."""
    data = vmlinuz.read_bytes()
    at = data.find(lzma_magic := b"\xfd7zXZ\x00")
    while at >= 0:
        try:
            kernel = lzma.LZMADecompressor().decompress(data[at:])
            if kernel.startswith(b"\x7fELF"):
                return kernel
        except lzma.LZMAError:
            pass
        at = data.find(lzma_magic, at + 1)
    return None


def write_ramdisk(image, version):
    root = image / "ramdisk"
    for folder in ("bin", "modules", "proc", "sys", "dev", "host", "upper", "root"):
        (root / folder).mkdir(parents=True)
    busybox = shutil.which("busybox")
    if busybox is None:
        raise Unavailable("rtvm: busybox is not installed; run ./dev setup")
    shutil.copy(busybox, root / "bin/busybox")
    order = []
    for module in BOOT_MODULES:
        steps = run("modprobe", "-d", str(image / "package"), "-S", version, "--show-depends", module)
        for line in steps.splitlines():
            if line.startswith("insmod ") and (path := line.split()[1]) not in order:
                order.append(path)
    for path in order:
        shutil.copy(path, root / "modules")
    (root / "modules/order").write_text("".join(pathlib.Path(path).name + "\n" for path in order))
    shutil.copy(INIT, root / "init")
    (root / "init").chmod(0o755)
    names = "\n".join(str(path.relative_to(root)) for path in sorted(root.rglob("*")))
    with open(image / "initrd", "wb") as archive:
        subprocess.run(["cpio", "-o", "-H", "newc", "--quiet"], input=names.encode(), cwd=root, stdout=archive, check=True)
    shutil.rmtree(root)


def prepare(kind):
    """The directory with `kernel`, `initrd`, `version` and `package/lib/modules` of this kind, made if need be."""
    name = package_name(kind)
    init_stamp = format(zlib.crc32(INIT.read_bytes() + pathlib.Path(__file__).read_bytes()), "08x")
    image = cache_directory() / f"{name}-{init_stamp}"
    if image.exists():
        return image
    image.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=image.parent) as scratch:
        work = pathlib.Path(scratch) / "image"
        work.mkdir()
        debs = list(image.parent.glob(f"{name}_*.deb"))
        if not debs:
            run("apt-get", "-q", "download", name, cwd=image.parent)
            debs = list(image.parent.glob(f"{name}_*.deb"))
        run("dpkg-deb", "-x", str(debs[-1]), str(work / "package"))
        version = next((work / "package/lib/modules").iterdir()).name
        run("depmod", "-b", str(work / "package"), version)
        vmlinuz = work / "package/boot" / f"vmlinuz-{version}"
        (work / "kernel").write_bytes(uncompressed(vmlinuz) or vmlinuz.read_bytes())
        (work / "version").write_text(version)
        write_ramdisk(work, version)
        try:
            work.rename(image)
        except OSError:  # another run was faster
            if not image.exists():
                raise
    return image
