"""Makes the network of a PyTorch file readable for a ForeignActor: `python -m training.import_actor FILE OUT`.

FILE is a state dict that torch.save wrote, of linear layers in the order in which they are applied. It is read without
executing anything of it. OUT is a safetensors file, for a method such as that of examples/06_foreign_actor.
"""

from __future__ import annotations

import pickle
import sys
from typing import Any, Dict, List, Optional

import numpy as np
import safetensors.numpy
import torch

from applr_ros1.common.errors import ApplrError, reason, run_main
from applr_ros1.common.files import write_bytes
from training.common.command_line import parsed
from training.common.options import Options, argument, option


class ImportOptions(Options):
    """What to import."""

    file: str = argument("State dict to read, as torch.save writes it.")
    out: str = argument("File to write, such as actor.safetensors.")
    prefix: str = option("", "Take only the tensors whose names begin so, such as actor. with its dot.")


def main(arguments: Optional[List[str]] = None) -> int:
    """The command. Exit status 0; 1 with one line on stderr where no network can be made."""
    program = "python -m training.import_actor"
    return run_main(lambda: _import(parsed(ImportOptions, program, __doc__, arguments)), "import_actor")


def _import(options: ImportOptions) -> None:
    weights = layers(read(options.file), options.prefix, options.file)
    write_bytes(options.out, safetensors.numpy.save(weights))
    sizes = [weights["0.weight"].shape[1]] + [len(weights["%d.bias" % i]) for i in range(len(weights) // 2)]
    print("%s: %s" % (options.out, " - ".join(map(str, sizes))))


def read(path: str) -> Dict[str, Any]:
    """The state dict in a file. Raises ApplrError; nothing of the file is executed."""
    try:
        found = torch.load(path, map_location="cpu", weights_only=True)
    except OSError as error:
        raise ApplrError("%s: cannot be read (%s)" % (path, reason(error))) from None
    except (pickle.UnpicklingError, RuntimeError, EOFError, ValueError, KeyError) as error:
        raise ApplrError(
            "%s: no state dict that can be read safely (%s); where you trust it, load it yourself and torch.save its "
            "state_dict()" % (path, reason(error)[:100])
        ) from None
    if not isinstance(found, dict):
        raise ApplrError("%s: holds a %s, not a state dict" % (path, type(found).__name__))
    return found


def layers(state: Dict[str, Any], prefix: str, path: str) -> Dict[str, np.ndarray]:
    """{"0.weight": ..., "0.bias": ..., "1.weight": ...} float32 of a state dict's linear layers, in its order.

    Raises:
        ApplrError: For other tensors than weights and biases, for values that are not finite, and for layers that do
            not fit one behind the other.
    """
    unnamed = next((name for name in state if not isinstance(name, str)), None)
    if unnamed is not None:
        kind = type(unnamed).__name__
        raise ApplrError("%s: a name in it is of type %s; a state dict has texts for names" % (path, kind))
    taken = {name: value for name, value in state.items() if name.startswith(prefix)}
    found: Dict[str, np.ndarray] = {}
    width = None
    for name, value in taken.items():
        if not name.endswith(".weight"):
            continue
        bias = taken.get(name[: -len("weight")] + "bias")
        if bias is None or (getattr(value, "ndim", 0), getattr(bias, "ndim", 0)) != (2, 1) or len(bias) != len(value):
            raise ApplrError("%s: %s is not the weight of a linear layer with a bias" % (path, name))
        if width not in (None, value.shape[1]):
            raise ApplrError("%s: %s takes %d inputs behind a layer of %d" % (path, name, value.shape[1], width))
        width, number = len(value), len(found) // 2
        found["%d.weight" % number] = _numbers(value, name, path)
        found["%d.bias" % number] = _numbers(bias, name[: -len("weight")] + "bias", path)
    if len(found) != len(taken) or not found:
        raise ApplrError(
            "%s: %d tensors of linear layers among %d%s; name theirs with --prefix"
            % (path, len(found), len(taken), " that begin with " + prefix if prefix else "")
        )
    return found


def _numbers(tensor: torch.Tensor, name: str, path: str) -> np.ndarray:
    """A tensor's values as float32. Raises ApplrError where one is not finite, or where they are none."""
    try:
        values = np.array(tensor.detach().to_dense().float().numpy())
    except (RuntimeError, TypeError, NotImplementedError) as error:
        raise ApplrError("%s: %s: its values cannot be read (%s)" % (path, name, reason(error)[:100])) from None
    if not np.isfinite(values).all():
        raise ApplrError("%s: %s holds values that are not finite" % (path, name))
    return values


if __name__ == "__main__":
    sys.exit(main())
