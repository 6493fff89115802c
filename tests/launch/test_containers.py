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
    (base_image,) = re.findall(r"^FROM (.*)$", dockerfile, re.MULTILINE)
    (set_up_script,) = re.findall(r"^RUN (.*)$", dockerfile, re.MULTILINE)
    assert base_image in definition
    post_section = re.search(r"%post\n(.*?)\n\n", definition, re.DOTALL).group(1)
    assert post_section.split("\n")[-1].strip() == set_up_script

    # Both run the same command, which Docker has as a JSON list. The last word stands for the
    # user's arguments.
    command = shlex.split(re.search(r"exec (.*)", definition).group(1))[:-1]
    assert json.dumps(command) in dockerfile
    assert os.access(FOLDER / Path(set_up_script).name, os.X_OK)
