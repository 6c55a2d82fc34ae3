"""A decoder with fixed weights, arranged for speed: few large products, and a backward pass that needs only signs.

With fixed weights the gradient of the features depends on which ReLUs were open only: 160 bits per sample. Same
values as `Decoder`; the tests compare them.
"""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor

from . import kernels
from .decoders import CHANNELS, EMBEDDING, LAYERS, SKIP_AFTER, WIDTH, Decoder, linear_layers

SKIP = SKIP_AFTER + 1  # the layer that takes the embedding again


class FrozenDecoder:
    """A copy of `decoder`: gradients of its first 32 features, values of its first `outputs` outputs."""

    def __init__(self, decoder: Decoder, outputs: int = 1) -> None:
        hidden, injection = linear_layers(decoder.hidden), linear_layers(decoder.injection)
        weights = [layer.weight.detach() for layer in hidden]
        # u of V c + u is not added to a state but moved into the bias of the next layer
        self.shifts = shifts = [layer.bias.detach() for layer in injection]
        weights[SKIP], skipped = weights[SKIP][:, EMBEDDING:].contiguous(), weights[SKIP][:, :EMBEDDING]
        biases = [layer.bias.detach() for layer in hidden]
        self.biases = [biases[0], *(b + w @ u for b, w, u in zip(biases[1:], weights[1:], shifts, strict=False))]
        self.embedding = decoder.embedding.detach().contiguous()
        # (93, 64): weights from the embedding to the first layer and, by the skip, to the fourth
        self.entry = torch.cat([weights[0], skipped]).T.contiguous()
        self.entry_bias = torch.cat([self.biases[0], self.biases[SKIP]])
        self.back = weights
        self.forth = [weight.T.contiguous() for weight in weights]
        self.injections = [layer.weight.detach().T.contiguous() for layer in injection]
        self.injections_back = [layer.weight.detach()[:, :CHANNELS].contiguous() for layer in injection]
        self.output = decoder.output.weight.detach()[:outputs]
        self.output_bias = decoder.output.bias.detach()[:outputs] + self.output @ shifts[-1]

    def values(self, points: Tensor, features: Tensor) -> tuple[Tensor, Tensor]:
        """Outputs (N, O) at points (N, 3) with features (N, C), and the open ReLUs (5, N, 32) uint8 for `gradients`."""
        _, states, opened = self._forward(points, features)
        return torch.addmm(self.output_bias, states[-1], self.output.T), opened

    def gradients(self, opened: Tensor, of_values: Tensor, points: Tensor | None) -> tuple[Tensor, Tensor | None]:
        """Gradients of the first 32 features (N, 32) and, if `points` are given, of them (N, 3) by the embedding.

        of_values (N, O): gradient of the outputs.
        """
        of_features = of_values.new_zeros(len(of_values), CHANNELS)
        of_entry = of_values.new_empty(len(of_values), 2 * WIDTH)
        for layer, of_state, of_inner in self._backward(opened, of_values):
            of_features.addmm_(of_state, self.injections_back[layer])
            if points is not None and layer in (0, SKIP):
                _half(of_entry, layer).copy_(of_inner)
        if points is None:
            return of_features, None
        return of_features, torch.mm(self._of_angles(points, of_entry), self.embedding.T)

    def learn(self, points: Tensor, features: Tensor, of_values: Tensor) -> tuple[Tensor, Tensor, list[Tensor]]:
        """Gradients of the features (N, 32), of the points (N, 3) by the embedding, and of all weights.

        of_values (N, O): gradient of the outputs. Weights are in the order of `Decoder.parameters`, whose fourth output
        gets the gradient 0.
        """
        embedded, states, opened = self._forward(points, features)
        of_features, of_entry = torch.zeros(len(points), CHANNELS), torch.empty(len(points), 2 * WIDTH)
        hidden: list[Tensor] = []
        injected: list[Tensor] = []
        for layer, of_state, of_inner in self._backward(opened, of_values):
            of_features.addmm_(of_state, self.injections_back[layer])
            injected[:0] = [of_state.T @ features, of_state.sum(0)]
            of_bias, of_weights = of_inner.sum(0), []  # of the embedding, if it is an input; of the state before
            if layer in (0, SKIP):
                _half(of_entry, layer).copy_(of_inner)
                of_weights.append(of_inner.T @ embedded)
            if layer:
                of_weights.append(of_inner.T @ states[layer - 1] + of_bias[:, None] * self.shifts[layer - 1])
            hidden[:0] = [torch.cat(of_weights, 1), of_bias]
        of_angles = self._of_angles(points, of_entry)
        of_bias = of_values.sum(0)
        of_output = of_values.T @ states[-1] + of_bias[:, None] * self.shifts[-1]
        unused = torch.zeros(1, WIDTH)
        output = [torch.cat([of_output, unused]), torch.cat([of_bias, unused[0, :1]])]
        learned = [points.T @ of_angles, *hidden, *injected, *output]
        return of_features, torch.mm(of_angles, self.embedding.T), learned

    def _forward(self, points: Tensor, features: Tensor) -> tuple[Tensor, list[Tensor], Tensor]:
        """The embedding (N, 93), the state (N, 32) after each layer without its shift, and the open ReLUs."""
        angles = torch.mm(points, self.embedding)
        embedded = torch.empty_like(angles)  # the compiled loop is slow in place
        kernels.sine(angles.view(-1).numpy(), embedded.view(-1).numpy())
        entry = torch.addmm(self.entry_bias, embedded, self.entry)
        opened = torch.empty(LAYERS, len(points), WIDTH, dtype=torch.uint8)
        states = [entry[:, :WIDTH].contiguous()]
        for layer in range(LAYERS):
            if layer:
                start = entry[:, WIDTH:] if layer == SKIP else self.biases[layer]
                states.append(torch.addmm(start, states[-1], self.forth[layer]))
            kernels.rectify(states[-1].view(-1).numpy(), opened[layer].view(-1).numpy())
            states[-1].addmm_(features, self.injections[layer])
        return embedded, states, opened

    def _backward(self, opened: Tensor, of_values: Tensor) -> Iterator[tuple[int, Tensor, Tensor]]:
        """From the last layer to the first: its number, the gradient (N, 32) of its state, and that before its ReLU.

        The tensors are overwritten in the next step.
        """
        state = torch.mm(of_values, self.output)
        gated = torch.empty_like(state)
        for layer in range(LAYERS - 1, -1, -1):
            kernels.gate(state.view(-1).numpy(), opened[layer].view(-1).numpy(), gated.view(-1).numpy())
            yield layer, state, gated
            if layer:
                torch.mm(gated, self.back[layer], out=state)

    def _of_angles(self, points: Tensor, of_entry: Tensor) -> Tensor:
        """Gradient (N, 93) of the angles from that (N, 64) of the inputs of the first and the fourth layer."""
        angles = torch.mm(points, self.embedding)
        slopes = torch.empty_like(angles)
        kernels.cosine(angles.view(-1).numpy(), slopes.view(-1).numpy())
        return torch.mm(of_entry, self.entry.T).mul_(slopes)


def _half(of_entry: Tensor, layer: int) -> Tensor:
    return of_entry[:, WIDTH:] if layer else of_entry[:, :WIDTH]
