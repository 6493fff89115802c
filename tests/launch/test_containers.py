"""Tests that both container images are built by one script and run the same command. CI builds the
Docker image.
"""

import json
import os
import re
import shlex
from pathlib import Path

from tests.support import ROOT

FOLDER = ROOT / "containers"


def test_both_images_are_made_and_run_alike():
    definition = (FOLDER / "apptainer.def").read_text(encoding="utf-8")
    dockerfile = (FOLDER / "Dockerfile").read_text(encoding="utf-8")

    # Both begin with the same image, and end with the same script.
    (image,) = re.findall(r"^FROM (.*)$", dockerfile, re.MULTILINE)
    (step,) = re.findall(r"^RUN (.*)$", dockerfile, re.MULTILINE)
    assert image in definition
    post = re.search(r"%post\n(.*?)\n\n", definition, re.DOTALL).group(1)
    assert post.split("\n")[-1].strip() == step

    # Both run the same command, which Docker has as a JSON list. The last word stands for the
    # user's arguments.
    words = shlex.split(re.search(r"exec (.*)", definition).group(1))[:-1]
    assert json.dumps(words) in dockerfile
    assert os.access(FOLDER / Path(step).name, os.X_OK)
