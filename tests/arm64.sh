#!/bin/sh
# The wheel on ARM64, emulated: Debian's ARM64 in build/arm64, the package by pip, the bundled recording with two systems, and how far
# its poses are from this machine's. Twenty minutes of one core. As root, on Debian or Ubuntu, in a checkout after `make package`:
#     apt-get install debootstrap qemu-user-static && sh tests/arm64.sh
set -eu
[ "$(id -u)" = 0 ] || { echo "tests/arm64.sh: has to change its root, so it needs to be root"; exit 2; }
for tool in debootstrap qemu-aarch64-static; do
    command -v $tool >/dev/null || { echo "tests/arm64.sh: apt-get install debootstrap qemu-user-static"; exit 2; }
done
[ -e /proc/sys/fs/binfmt_misc/qemu-aarch64 ] || {
    echo "tests/arm64.sh: the kernel does not start ARM64 programs yet: mount -t binfmt_misc binfmt_misc /proc/sys/fs/binfmt_misc," \
        "then cat /usr/lib/binfmt.d/qemu-aarch64.conf > /proc/sys/fs/binfmt_misc/register"
    exit 2
}
root=$PWD/build/arm64
if [ ! -x "$root/venv/bin/pip" ]; then
    debootstrap --arch=arm64 --foreign --variant=minbase \
        --include=python3,python3-venv,python3-pip,ca-certificates bookworm "$root"
    chroot "$root" /debootstrap/debootstrap --second-stage
    chroot "$root" python3 -m venv /venv
fi
mount --bind /dev "$root/dev" && mount -t proc proc "$root/proc"
trap 'umount "$root/dev" "$root/proc"' EXIT
cp /etc/resolv.conf "$root/etc/"
rm -rf "$root/tried" && mkdir "$root/tried" && cp dist/touchline-*.whl "$root/tried/"
# Loops compiled ahead, if `make kernels` has made them with this machine's Python 3.11.
cp build/kernels/touchline_kernels-*-cp311-*_aarch64.whl "$root/tried/" 2>/dev/null || true
chroot "$root" sh -c '/venv/bin/pip install --no-compile --force-reinstall /tried/*.whl && /venv/bin/touchline --version'
cp -r examples/omni_msl_track_short "$root/tried/track"
for system in touchline nubot-mti; do
    .venv/bin/touchline run "$root/tried/track" --system $system --output "$root/tried/$system-here"
    chroot "$root" /venv/bin/touchline run /tried/track --system $system --output /tried/$system
    .venv/bin/python - "$root/tried/$system" <<'PYTHON'
import sys
import numpy as np
pose, here = (np.loadtxt(f"{sys.argv[1]}{end}/trajectory.tum") for end in ("", "-here"))
print("largest difference of a pose:", np.abs(pose - here).max(axis=0)[1:3], "m,", (pose != here).any(axis=1).sum(), "of", len(pose))
PYTHON
done
