"""Tests that both container images are built by one script and run the same command. CI builds the
Docker image.
"""

import os
import re
import shlex
from pathlib import Path

from tests.support import ROOT

FOLDER = ROOT / "containers"


def test_both_images_are_made_and_run_alike():
    definition, dockerfile = (
        (FOLDER / name).read_text(encoding="utf-8") for name in ("apptainer.def", "Dockerfile")
    )
    (image,) = re.findall(r"^FROM (.*)$", dockerfile, re.MULTILINE)
    (step,) = re.findall(r"^RUN (.*)$", dockerfile, re.MULTILINE)
    assert image in definition
    assert (
        re.search(r"%post\n(.*?)\n\n", definition, re.DOTALL).group(1).split("\n")[-1].strip()
        == step
    )
    words = shlex.split(re.search(r"exec (.*)", definition).group(1))[:-1]
    assert "[%s]" % ", ".join('"%s"' % word for word in words) in dockerfile
    assert os.access(FOLDER / Path(step).name, os.X_OK)
