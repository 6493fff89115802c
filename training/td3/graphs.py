"""Gradient steps on a GPU, recorded once and repeated. td3.py makes its steps through it where there is a GPU."""

from __future__ import annotations

from typing import Callable, Dict, Optional

import torch

from training.td3.batch import Batch


class Graphs:
    """Records the two kinds of update once as CUDA graphs and repeats them: no launch cost for 150 small kernels.

    Args:
        step: makes a gradient step with a batch; its second argument says whether it is one of the policy, too.
        policy_delay: every so many steps one is.
    """

    WARM_UP = 3

    def __init__(self, step: Callable[[Batch, bool], None], policy_delay: int):
        self.step, self.policy_delay, self.count = step, policy_delay, 0
        self.batch: Optional[Batch] = None
        self.graphs: Dict[bool, torch.cuda.CUDAGraph] = {}

    def run(self, batch: Batch, delayed: bool) -> None:
        """One update: by replay of the recorded graph where there is one, else step by step."""
        fields = vars(batch)
        if self.batch is not None and len(batch.reward) != len(self.batch.reward):
            self.step(batch, delayed)  # another batch size than the recorded one
            return
        if self.batch is None:
            self.batch = Batch(**{name: tensor.clone() for name, tensor in fields.items()})
        for name, tensor in fields.items():
            getattr(self.batch, name).copy_(tensor, non_blocking=True)
        self.count += 1
        if self.count <= self.WARM_UP * self.policy_delay:
            self._warm(self.batch, delayed)
        elif delayed not in self.graphs:
            self._record(self.batch, delayed)
        if delayed in self.graphs:
            self.graphs[delayed].replay()

    def _warm(self, batch: Batch, delayed: bool) -> None:
        """The first updates run as usual, on a side stream, as recording asks for."""
        stream = torch.cuda.Stream()
        stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(stream):
            self.step(batch, delayed)
        torch.cuda.current_stream().wait_stream(stream)

    def _record(self, batch: Batch, delayed: bool) -> None:
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            self.step(batch, delayed)
        self.graphs[delayed] = graph
