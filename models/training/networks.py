"""The networks of the paper (section "Classification Models"), and their export as ONNX graphs.

    window   [batch, channels, samples]           ─▶ z-score ─▶ three blocks of convolution ─▶ head ─▶ logits
    sequence [batch, windows, channels, samples]  ─▶ z-score ─▶ LSTM, one step per window   ─▶ head ─▶ logits

The graphs are written node by node. A 1D convolution is written as a 2D convolution of height 1, because ONNX
Runtime has fast (NCHWc) kernels only for the 2D form: a window then takes half the time. PyTorch trains twice as fast
that way, too.
"""

from pathlib import Path

import numpy as np
import onnx
import torch
import torch.nn.utils.fusion
from torch import nn

LSTM_UNITS = 128


class GestureCnn(nn.Module):
    """[batch, channels, samples] to [batch, classes] logits; z-score included."""

    name = "cnn"

    def __init__(self, mean: torch.Tensor, std: torch.Tensor, samples: int, classes: int):
        super().__init__()
        channels = len(mean)
        self.register_buffer("mean", mean.reshape(1, channels, 1))
        self.register_buffer("std", std.reshape(1, channels, 1))

        def block(inputs: int, outputs: int, kernel: int) -> nn.Sequential:
            # The paper applies ReLU before the pooling. The result is the same, at half the work.
            return nn.Sequential(
                nn.Conv2d(inputs, outputs, (1, kernel), padding=(0, kernel // 2)),
                nn.BatchNorm2d(outputs),
                nn.MaxPool2d((1, 2)),
                nn.ReLU(),
            )

        self.features = nn.Sequential(block(channels, 32, 7), block(32, 64, 5), block(64, 128, 5))
        self.features.append(nn.Sequential(nn.AdaptiveAvgPool2d(1), nn.Flatten()))
        self.head = head(128, classes)
        self.to(memory_format=torch.channels_last)

    def forward(self, window: torch.Tensor) -> torch.Tensor:
        image = ((window - self.mean) / self.std)[:, :, None, :].contiguous(memory_format=torch.channels_last)
        return self.head(self.features(image))

    def add_to(self, graph: "Graph") -> None:
        x = graph.normalised("window", self.mean, self.std)
        x = graph.node("Unsqueeze", [x, graph.constant("height_axis", np.array([2]))], "image")
        for index, block in enumerate(self.eval().features[:3]):
            convolution = torch.nn.utils.fusion.fuse_conv_bn_eval(block[0], block[1])
            kernel = convolution.weight.shape[3]
            weight = graph.constant(f"conv{index}.weight", convolution.weight)
            bias = graph.constant(f"conv{index}.bias", convolution.bias)
            pads = [0, kernel // 2, 0, kernel // 2]
            x = graph.node("Conv", [x, weight, bias], f"conv{index}", kernel_shape=[1, kernel], pads=pads)
            x = graph.node("Relu", [x], f"relu{index}")
            x = graph.node("MaxPool", [x], f"pool{index}", kernel_shape=[1, 2], strides=[1, 2])
        x = graph.node("Flatten", [graph.node("GlobalAveragePool", [x], "average")], "features")
        graph.add_head(x, self.head)


class GestureLstm(nn.Module):
    """[batch, windows, channels, samples] to [batch, classes] logits; z-score included.

    The paper says only that an LSTM reads sequences of five windows. Here a window is a step and all of its samples are
    the step's features; the state after the last window goes to the head of the CNN.
    """

    name = "lstm"

    def __init__(self, mean: torch.Tensor, std: torch.Tensor, samples: int, classes: int):
        super().__init__()
        channels = len(mean)
        self.register_buffer("mean", mean.reshape(1, 1, channels, 1))
        self.register_buffer("std", std.reshape(1, 1, channels, 1))
        self.lstm = nn.LSTM(channels * samples, LSTM_UNITS, batch_first=True)
        self.head = head(LSTM_UNITS, classes)

    def forward(self, sequence: torch.Tensor) -> torch.Tensor:
        steps = ((sequence - self.mean) / self.std).flatten(2)
        return self.head(self.lstm(steps)[0][:, -1])

    def add_to(self, graph: "Graph") -> None:
        windows = graph.shape[0]
        x = graph.normalised("window", self.mean, self.std)
        # Steps come first, then the batch of one.
        shape = graph.constant("steps_shape", np.array([windows, 1, self.lstm.input_size]))
        x = graph.node("Reshape", [x, shape], "steps")
        # PyTorch orders the gates input, forget, cell, output; ONNX orders them input, output, forget, cell.
        order = [0, 3, 1, 2]

        def gates(weight: torch.Tensor) -> torch.Tensor:
            return torch.cat([weight.chunk(4)[gate] for gate in order])

        weights = self.lstm
        bias = torch.cat([gates(weights.bias_ih_l0), gates(weights.bias_hh_l0)])
        inputs = [
            x,
            graph.constant("lstm.input", gates(weights.weight_ih_l0)[None]),
            graph.constant("lstm.recurrent", gates(weights.weight_hh_l0)[None]),
            graph.constant("lstm.bias", bias[None]),
        ]
        graph.node("LSTM", inputs, ["", "last_state"], hidden_size=LSTM_UNITS)
        shape = graph.constant("features_shape", np.array([1, LSTM_UNITS]))
        graph.add_head(graph.node("Reshape", ["last_state", shape], "features"), self.head)


NETWORKS = {network.name: network for network in (GestureCnn, GestureLstm)}


def head(features: int, classes: int) -> nn.Sequential:
    """Features to logits."""
    return nn.Sequential(nn.Linear(features, 64), nn.ReLU(), nn.Dropout(0.5), nn.Linear(64, classes))


class Graph:
    """An ONNX graph being written: input `window` [1, *shape], output `probabilities` [1, classes]."""

    def __init__(self, shape: tuple[int, ...]):
        self.shape = shape
        self.nodes = []
        self.initializers = []

    def constant(self, name: str, value) -> str:
        array = value.detach().cpu().numpy() if isinstance(value, torch.Tensor) else value
        self.initializers.append(onnx.numpy_helper.from_array(np.ascontiguousarray(array), name))
        return name

    def node(self, kind: str, inputs: list[str], output, **attributes) -> str:
        outputs = output if isinstance(output, list) else [output]
        self.nodes.append(onnx.helper.make_node(kind, inputs, outputs, **attributes))
        return outputs[0]

    def normalised(self, x: str, mean: torch.Tensor, std: torch.Tensor) -> str:
        x = self.node("Sub", [x, self.constant("mean", mean)], "centred")
        return self.node("Div", [x, self.constant("std", std)], "normalised")

    def add_head(self, x: str, layers: nn.Sequential) -> None:
        for name, layer in (("hidden", layers[0]), ("logits", layers[3])):
            weight = self.constant(f"{name}.weight", layer.weight)
            bias = self.constant(f"{name}.bias", layer.bias)
            x = self.node("Gemm", [x, weight, bias], name, transB=1)
            if name == "hidden":
                x = self.node("Relu", [x], "hidden_relu")
        self.node("Softmax", [x], "probabilities", axis=1)


def export(model: nn.Module, shape: tuple[int, ...], metadata: dict[str, str], out: Path) -> None:
    """Writes OUT: input `window` [1, *shape], output `probabilities` [1, classes]."""
    graph = Graph(shape)
    model.eval().add_to(graph)
    tensor = onnx.helper.make_tensor_value_info
    exported = onnx.helper.make_model(
        onnx.helper.make_graph(
            graph.nodes,
            f"gesture_{model.name}",
            [tensor("window", onnx.TensorProto.FLOAT, [1, *shape])],
            [tensor("probabilities", onnx.TensorProto.FLOAT, [1, model.head[3].out_features])],
            graph.initializers,
        ),
        opset_imports=[onnx.helper.make_opsetid("", 18)],
        ir_version=10,
    )
    onnx.helper.set_model_props(exported, metadata)
    onnx.checker.check_model(exported, full_check=True)
    onnx.save(exported, out)
