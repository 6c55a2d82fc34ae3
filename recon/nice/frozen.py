"""A decoder whose weights stand still, arranged for speed: few large products, a backward pass that needs only signs.

With weights that do not learn, the gradient of the features only asks which ReLUs were open: 160 bits of a sample.
The same numbers as `Decoder`, which the tests hold it against.
"""

from __future__ import annotations

import torch
from torch import Tensor

from . import kernels
from .decoders import CHANNELS, EMBEDDING, LAYERS, SKIP_AFTER, WIDTH, Decoder

SKIP = SKIP_AFTER + 1  # the layer that sees the embedding again


class FrozenDecoder:
    """`decoder` as it is now. Its first 32 features take gradients; its first `outputs` outputs are made."""

    def __init__(self, decoder: Decoder, outputs: int = 1) -> None:
        weights = [layer.weight.detach() for layer in decoder.hidden]
        shifts = [layer.bias.detach() for layer in decoder.injection]  # carried on into the biases of the next layer
        weights[SKIP], skipped = weights[SKIP][:, EMBEDDING:].contiguous(), weights[SKIP][:, :EMBEDDING]
        biases = [layer.bias.detach() for layer in decoder.hidden]
        self.biases = [biases[0], *(b + w @ u for b, w, u in zip(biases[1:], weights[1:], shifts, strict=False))]
        self.embedding = decoder.embedding.detach().contiguous()
        # what the embedding gives to the first layer and, past the skip, to the fourth: (93, 64)
        self.entry = torch.cat([weights[0], skipped]).T.contiguous()
        self.entry_bias = torch.cat([self.biases[0], self.biases[SKIP]])
        self.back = weights
        self.forth = [weight.T.contiguous() for weight in weights]
        self.injections = [layer.weight.detach().T.contiguous() for layer in decoder.injection]
        self.injections_back = [layer.weight.detach()[:, :CHANNELS].contiguous() for layer in decoder.injection]
        self.output = decoder.output.weight.detach()[:outputs]
        self.output_bias = decoder.output.bias.detach()[:outputs] + self.output @ shifts[-1]

    def values(self, points: Tensor, features: Tensor) -> tuple[Tensor, Tensor]:
        """points (N, 3), features (N, C) -> outputs (N, O), and the open ReLUs (5, N, 32) uint8 for `gradients`."""
        angles = torch.mm(points, self.embedding)
        embedded = torch.empty_like(angles)  # the compiled loop is only quick between two arrays
        kernels.sine(angles.view(-1).numpy(), embedded.view(-1).numpy())
        entry = torch.addmm(self.entry_bias, embedded, self.entry)
        opened = torch.empty(LAYERS, len(points), WIDTH, dtype=torch.uint8)
        state = entry[:, :WIDTH].contiguous()
        for layer in range(LAYERS):
            if layer:
                start = entry[:, WIDTH:] if layer == SKIP else self.biases[layer]
                state = torch.addmm(start, state, self.forth[layer])
            kernels.rectify(state.view(-1).numpy(), opened[layer].view(-1).numpy())
            state.addmm_(features, self.injections[layer])
        return torch.addmm(self.output_bias, state, self.output.T), opened

    def gradients(self, opened: Tensor, of_values: Tensor, points: Tensor | None) -> tuple[Tensor, Tensor | None]:
        """From that of the outputs (N, O): gradient of the first 32 features (N, 32); of the points (N, 3), where they
        are given, through the embedding alone."""
        state = torch.mm(of_values, self.output)
        of_features = torch.mm(state, self.injections_back[-1])
        of_entry = torch.empty(len(of_values), 2 * WIDTH) if points is not None else None
        gated = torch.empty_like(state)
        for layer in range(LAYERS - 1, -1, -1):
            if layer == 0 and of_entry is None:
                break
            kernels.gate(state.view(-1).numpy(), opened[layer].view(-1).numpy(), gated.view(-1).numpy())
            if of_entry is not None and layer in (0, SKIP):
                of_entry[:, WIDTH * (layer > 0) : WIDTH * (1 + (layer > 0))] = gated
            if layer:
                torch.mm(gated, self.back[layer], out=state)
                of_features.addmm_(state, self.injections_back[layer - 1])
        if points is None:
            return of_features, None
        angles = torch.mm(points, self.embedding)
        slopes = torch.empty_like(angles)
        kernels.cosine(angles.view(-1).numpy(), slopes.view(-1).numpy())
        return of_features, torch.mm(torch.mm(of_entry, self.entry.T).mul_(slopes), self.embedding.T)
