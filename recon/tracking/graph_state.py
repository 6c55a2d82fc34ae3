"""What a keyframe graph holds, as plain tensors and containers: for the state of an unfinished map."""

from __future__ import annotations

from typing import Any

import torch

from .frame_to_frame import SurfaceView
from .keyframe_graph import KeyframeGraph
from .landmarks import FrameFeatures


def to_state(graph: KeyframeGraph) -> dict[str, Any]:
    """For `load_state`."""
    return {
        "sightings": [s.to_state() for s in graph.frames],
        "keyframes": list(graph.keyframes),
        "views": {k: v.to_state() for k, v in graph.views.items()},
        "edges": [(a, b, torch.from_numpy(m), torch.from_numpy(i)) for a, b, m, i in graph.edges],
        "loops": list(graph.loops),
        "landmarks": {n: torch.from_numpy(v) for n, v in vars(graph.landmarks).items()},
    }


def load_state(graph: KeyframeGraph, state: dict[str, Any]) -> None:
    """Let `graph` continue from a state."""
    graph.frames = [FrameFeatures.from_state(s) for s in state["sightings"]]
    graph.keyframes = list(state["keyframes"])
    graph.views = {k: SurfaceView.from_state(v) for k, v in state["views"].items()}
    graph.edges = [(a, b, m.numpy(), i.numpy()) for a, b, m, i in state["edges"]]
    graph.loops = [tuple(loop) for loop in state["loops"]]
    for name, values in state["landmarks"].items():
        setattr(graph.landmarks, name, values.numpy())
