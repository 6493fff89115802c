"""What examples/03_offline_from_a_bag/recording.py has, for tests: drives in simulation recorded as a robot's are."""

import importlib.util

from tests.support import ROOT

_spec = importlib.util.spec_from_file_location(
    "recording", ROOT / "examples" / "03_offline_from_a_bag" / "recording.py"
)
_recording = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(_recording)

ABORTED, PREEMPTED, SUCCEEDED = _recording.ABORTED, _recording.PREEMPTED, _recording.SUCCEEDED
RecordingEpisode, StackWriter = _recording.RecordingEpisode, _recording.StackWriter
