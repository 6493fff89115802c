"""Both images from one script: its steps in a root of debootstrap, then a drive there as a user without rights."""

import os
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.support import ROOT

FOLDER = ROOT / "containers"
DEFINITION = (FOLDER / "apptainer.def").read_text(encoding="utf-8")
DOCKERFILE = (FOLDER / "Dockerfile").read_text(encoding="utf-8")
POST = re.search(r"%post\n(.*?)\n\n", DEFINITION, re.DOTALL).group(1)
RUN = shlex.split(re.search(r"exec (.*)", DEFINITION).group(1))[:-1]
SETTINGS = ("/etc/resolv.conf", "/etc/pip.conf", "/etc/xdg/pip", "/etc/apt", "/usr/share/keyrings")  # of a machine
SETTINGS += ("/etc/ssl", "/etc/ca-certificates.conf", "/usr/local/share/ca-certificates")


def test_both_images_are_made_and_run_alike():
    (image,) = re.findall(r"^FROM (.*)$", DOCKERFILE, re.MULTILINE)
    (step,) = re.findall(r"^RUN (.*)$", DOCKERFILE, re.MULTILINE)
    assert image in DEFINITION
    assert POST.split("\n")[-1].strip() == step
    assert "[%s]" % ", ".join('"%s"' % word for word in RUN) in DOCKERFILE
    assert os.access(FOLDER / Path(step).name, os.X_OK)


def folders_of_pip():
    """Folders of this machine that pip installs from."""
    said = subprocess.run(["pip", "config", "list"], capture_output=True, text=True).stdout + str(os.environ)
    named = (Path(name) for name in re.findall(r"(?<![\w:/])(?:file://)?(/[\w./-]+)", said))
    return {Path("/", *folder.parts[1:3]) for folder in named if folder.is_dir() and folder.parts[1] == "opt"}


@pytest.mark.long
@pytest.mark.skipif(os.getuid() != 0 or not shutil.which("debootstrap"), reason="needs root and debootstrap")
def test_the_steps_of_the_images_in_a_bare_debian(tmp_path):
    """With this machine's own settings of apt and pip, whatever they are. Some ten minutes and 4 GB."""
    root, tar = tmp_path / "root", tmp_path / "applr_ros1.tar"
    subprocess.run(["debootstrap", "--variant=minbase", "bookworm", str(root)], check=True)
    subprocess.run(["git", "archive", "--prefix=applr_ros1/", "-o", tar, "HEAD"], cwd=ROOT, check=True)
    shutil.copy(tar, root / "opt")
    for name in SETTINGS:
        if os.path.isdir(name):
            shutil.copytree(name, root / name[1:], dirs_exist_ok=True, symlinks=True)
        elif os.path.exists(name):
            shutil.copy(name, root / name[1:])
    mounts = ["mount -t proc proc %s/proc" % root, "mount --bind /dev %s/dev" % root]
    for folder in folders_of_pip():
        (root / folder.relative_to("/")).mkdir(parents=True, exist_ok=True)
        mounts.append("mount --bind %s %s%s" % (folder, root, folder))

    home = tmp_path / "home"

    def enter(command, *before, user="0:0", at="/root"):
        inner = ["chroot", "--userspec=" + user, root, "env", "HOME=" + at, "sh", "-ec", command]
        lines = [*before, *mounts, "exec " + shlex.join(map(str, inner))]
        done = subprocess.run(["unshare", "--mount", "sh", "-ec", "\n".join(lines)], capture_output=True, text=True)
        assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
        return done.stdout

    enter(POST)
    for folder in (home, root / "home" / "user"):
        folder.mkdir()
        folder.chmod(0o777)
    read_only = (  # /tmp and the home are the user's, as with Apptainer
        f"mount --bind {root} {root}; mount -o remount,ro,bind {root}",
        f"mount -t tmpfs tmp {root}/tmp; mount --bind {home} {root}/home/user",
    )

    def run(command):
        return enter(f"cd; {shlex.join(RUN)} {command}", *read_only, user="1000:1000", at="/home/user")

    assert run("rospack find applr_ros1").strip().endswith("catkin_ws/src/applr_ros1")
    run("python -m training.evaluate --worlds generated:0 --methods applr --simulator kinematic --trials 1 --out out")
    assert "generated:0,applr" in (home / "out" / "trials.csv").read_text(encoding="utf-8")
