"""Network that predicts the confidence of each measured depth from its image; docs/baselines.md, `nice-slam-pre`."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn.functional import interpolate, max_pool2d

PARAMETERS = 370_241
SMALLEST_SIDE = 8  # pixels: reflection at the border needs some image on both scales
_FEATURES = 64
_START_BIAS = 1.0


class ConfidenceNetwork(nn.Module):
    """Depth (N, 1, H, W) metres, 0 = no measurement -> s (N, 1, H, W) >= 0; the confidence is exp(-s).

    RoutedFusion's routing network without its depth head: two convolutions at full size, two at half, brought together
    by a head of two. Its last layer ends in a ReLU, too, which kills all gradients where s is 0 everywhere; the bias of
    that layer therefore starts at 1.
    """

    def __init__(self, generator: torch.Generator | None = None) -> None:
        super().__init__()
        f = _FEATURES
        self.pre = nn.Sequential(*_convolution(1, f), *_convolution(f, f))
        self.process = nn.Sequential(*_convolution(f, 2 * f), *_convolution(2 * f, 2 * f))
        self.head = nn.Sequential(*_convolution(3 * f, f), *_convolution(f, 1))
        if generator is not None:
            self._start(generator)
        assert sum(values.numel() for values in self.parameters()) == PARAMETERS

    def forward(self, depth: Tensor) -> Tensor:
        """Depth (N, 1, H, W) metres, 0 = no measurement -> s (N, 1, H, W), at least 0."""
        fine = self.pre(depth)
        coarse = self.process(max_pool2d(fine, 3, stride=2, padding=1))
        coarse = interpolate(coarse, scale_factor=2, mode="bilinear", align_corners=False)
        return self.head(torch.cat([fine, coarse[..., : fine.shape[-2], : fine.shape[-1]]], 1))

    def _start(self, generator: torch.Generator) -> None:
        """PyTorch's own initial values (uniform, bound 1 / sqrt(inputs)), from `generator`."""
        with torch.no_grad():
            for layer in self.modules():
                if isinstance(layer, nn.Conv2d):
                    bound = layer.weight[0].numel() ** -0.5
                    for values in layer.parameters():  # weight, bias
                        values.uniform_(-bound, bound, generator=generator)
            *_, last_bias = self.head.parameters()
            last_bias.fill_(_START_BIAS)


def channels_last(network: ConfidenceNetwork) -> ConfidenceNetwork:
    """Move the weights to the memory format in which convolutions are fastest; returns the network."""
    return network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # not in its stubs


@torch.no_grad()
def confidence_image(network: ConfidenceNetwork, depth: Tensor) -> Tensor:
    """depth (H, W) metres, 0 = no measurement -> (H, W) float32 confidence in 0..1, 0 where there is no measurement."""
    images = depth[None, None].float().contiguous(memory_format=torch.channels_last)
    return torch.exp(-network(images)[0, 0].float()) * (depth > 0)


def _convolution(inputs: int, outputs: int) -> tuple[nn.Module, nn.Module]:
    return nn.Conv2d(inputs, outputs, 3, padding=1, padding_mode="reflect"), nn.ReLU()
