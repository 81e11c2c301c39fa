"""Trains the 1D CNN of the paper (section "Classification Models") and exports it to ONNX with its contract.

    scripts/train --dataset DIR --classes six  --out models/cnn-six-class.onnx
    scripts/train --dataset DIR --classes five --out models/cnn-five-gesture.onnx
    scripts/train --smoke

DIR is what `tendon dataset build` wrote: windows that went through the same filters, onset detection and
windowing as the live pipeline (windows.npy [n, channels, samples] float32, labels.npy, people.npy,
manifest.json). A model of envelopes (`--input envelope` there) can be evaluated, but not run live. The people named by --test-people are never seen in training; of the other windows, 20 % of
each class are kept for validation and the epoch with the best validation accuracy is the one exported.

Beside OUT this writes OUT with the ending .md, the model card, and prints the same numbers.

With --smoke it trains a tiny run on windows made here, to see that everything works: data set, training, export,
parity with ONNX Runtime. Nothing of it is kept.
"""

import argparse
import json
import tempfile
import time
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import torch
import torch.nn.utils.fusion
from torch import nn

CONTRACT_VERSION = "1"
GESTURES = ["rest", "extension", "flexion", "ulnar", "radial", "grip"]
CLASSES = {"six": GESTURES, "five": GESTURES[1:]}
BATCH = 128
LEARNING_RATE = 1e-3
WEIGHT_DECAY = 1e-4
VALIDATION_SHARE = 0.2
PARITY_TOLERANCE = 1e-4
# Of --smoke: windows of each gesture and person, epochs, and the test accuracy that shows that it learned.
SMOKE_WINDOWS = 120
SMOKE_EPOCHS = 4
SMOKE_ACCURACY = 0.9
# What the paper's recordings were filtered with: for a data set of recordings that were filtered before.
PAPER_FILTER = {"notch_hz": 50.0, "notch_quality": 30.0, "band_pass_hz": [5.0, 500.0], "band_pass_order": 6}
# Test accuracy in the paper, by number of classes.
PAPER_ACCURACY = {6: 0.8646, 5: 0.9055}


class GestureCnn(nn.Module):
    """[batch, channels, samples] of the filtered signal to [batch, classes] logits; z-score included."""

    def __init__(self, mean: torch.Tensor, std: torch.Tensor, classes: int):
        super().__init__()
        channels = len(mean)
        self.register_buffer("mean", mean.reshape(1, channels, 1))
        self.register_buffer("std", std.reshape(1, channels, 1))

        def block(inputs: int, outputs: int, kernel: int) -> nn.Sequential:
            return nn.Sequential(
                nn.Conv1d(inputs, outputs, kernel, padding=kernel // 2),
                nn.BatchNorm1d(outputs),
                nn.ReLU(),
                nn.MaxPool1d(2),
            )

        self.features = nn.Sequential(block(channels, 32, 7), block(32, 64, 5), block(64, 128, 5))
        self.head = nn.Sequential(
            nn.AdaptiveAvgPool1d(1),
            nn.Flatten(),
            nn.Linear(128, 64),
            nn.ReLU(),
            nn.Dropout(0.5),
            nn.Linear(64, classes),
        )

    def forward(self, window: torch.Tensor) -> torch.Tensor:
        return self.head(self.features((window - self.mean) / self.std))


def stratified_split(labels: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Indices into `labels` for training and validation, each class split alike."""
    train, validation = [], []
    for label in np.unique(labels):
        indices = rng.permutation(np.flatnonzero(labels == label))
        kept = round(len(indices) * VALIDATION_SHARE)
        validation.append(indices[:kept])
        train.append(indices[kept:])
    return np.concatenate(train), np.concatenate(validation)


def channel_statistics(windows: np.ndarray, indices: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
    """Mean and standard deviation of each channel over the given windows, summed in float64."""
    total = np.zeros(windows.shape[1])
    squares = np.zeros(windows.shape[1])
    for chunk in np.array_split(np.sort(indices), max(1, len(indices) // 4096)):
        part = windows[chunk].astype(np.float64)
        total += part.sum(axis=(0, 2))
        squares += (part**2).sum(axis=(0, 2))
    count = len(indices) * windows.shape[2]
    mean = total / count
    std = np.sqrt(squares / count - mean**2)
    return torch.tensor(mean, dtype=torch.float32), torch.tensor(std, dtype=torch.float32)


@torch.no_grad()
def predict(model: nn.Module, windows: np.ndarray, indices: np.ndarray) -> np.ndarray:
    """Predicted class of each window at `indices`, in their order."""
    model.eval()
    batches = (indices[start : start + 512] for start in range(0, len(indices), 512))
    return np.concatenate([model(torch.from_numpy(windows[batch])).argmax(1).numpy() for batch in batches])


def train(windows, labels, train_indices, validation_indices, classes, epochs, rng):
    """The model of the epoch with the best validation accuracy, that accuracy and that epoch (from 1)."""
    model = GestureCnn(*channel_statistics(windows, train_indices), classes)
    optimiser = torch.optim.Adam(model.parameters(), lr=LEARNING_RATE, weight_decay=WEIGHT_DECAY)
    criterion = nn.CrossEntropyLoss()
    best = (-1.0, 0, None)
    for epoch in range(1, epochs + 1):
        started = time.monotonic()
        model.train()
        loss_sum = 0.0
        order = rng.permutation(train_indices)
        for start in range(0, len(order), BATCH):
            batch = order[start : start + BATCH]
            optimiser.zero_grad()
            # Half the time of float32 on processors that have it; weights and validation stay float32.
            with torch.autocast("cpu", torch.bfloat16):
                logits = model(torch.from_numpy(windows[batch]))
            loss = criterion(logits.float(), torch.from_numpy(labels[batch]))
            loss.backward()
            optimiser.step()
            loss_sum += loss.item() * len(batch)
        accuracy = float((predict(model, windows, validation_indices) == labels[validation_indices]).mean())
        print(
            f"epoch {epoch:2d}/{epochs}  loss {loss_sum / len(order):.4f}  validation {accuracy:.4f}  "
            f"{time.monotonic() - started:.0f} s",
            flush=True,
        )
        if accuracy > best[0]:
            best = (accuracy, epoch, {key: value.clone() for key, value in model.state_dict().items()})
    model.load_state_dict(best[2])
    return model, best[0], best[1]


def confusion_matrix(truth: np.ndarray, predicted: np.ndarray, classes: int) -> np.ndarray:
    """Counts, one row a true class, one column a predicted class."""
    return np.bincount(truth * classes + predicted, minlength=classes * classes).reshape(classes, classes)


def export(model: GestureCnn, shape: tuple[int, int], metadata: dict[str, str], out: Path) -> None:
    """Writes OUT: input `window` [1, channels, samples], output `probabilities` [1, classes].

    The graph is written node by node, because it says the 1D convolutions as 2D ones of height 1: ONNX Runtime
    has its fast (NCHWc) kernels for those only, and a window then takes half the time.
    """
    weights = {name: value.detach().numpy() for name, value in fused(model).items()}
    nodes, initializers = [], []

    def constant(name: str, value: np.ndarray) -> str:
        initializers.append(onnx.numpy_helper.from_array(np.ascontiguousarray(value), name))
        return name

    def node(kind: str, inputs: list[str], output: str, **attributes) -> str:
        nodes.append(onnx.helper.make_node(kind, inputs, [output], **attributes))
        return output

    x = node("Sub", ["window", constant("mean", model.mean.numpy())], "centred")
    x = node("Div", [x, constant("std", model.std.numpy())], "normalised")
    x = node("Unsqueeze", [x, constant("height_axis", np.array([2], dtype=np.int64))], "image")
    for index in range(len(model.features)):
        weight = weights[f"conv{index}.weight"]
        kernel = weight.shape[2]
        inputs = [
            x,
            constant(f"conv{index}.weight", weight[:, :, None, :]),
            constant(f"conv{index}.bias", weights[f"conv{index}.bias"]),
        ]
        padding = [0, kernel // 2, 0, kernel // 2]
        x = node("Conv", inputs, f"conv{index}", kernel_shape=[1, kernel], pads=padding)
        x = node("Relu", [x], f"relu{index}")
        x = node("MaxPool", [x], f"pool{index}", kernel_shape=[1, 2], strides=[1, 2])
    x = node("Flatten", [node("GlobalAveragePool", [x], "average")], "features")
    hidden, last = (layer for layer in model.head if isinstance(layer, nn.Linear))
    for name, layer in (("hidden", hidden), ("logits", last)):
        weight = constant(f"{name}.weight", layer.weight.detach().numpy())
        bias = constant(f"{name}.bias", layer.bias.detach().numpy())
        x = node("Gemm", [x, weight, bias], name, transB=1)
        if layer is hidden:
            x = node("Relu", [x], "hidden_relu")
    node("Softmax", [x], "probabilities", axis=1)

    tensor = onnx.helper.make_tensor_value_info
    graph = onnx.helper.make_graph(
        nodes,
        "gesture_cnn",
        [tensor("window", onnx.TensorProto.FLOAT, [1, *shape])],
        [tensor("probabilities", onnx.TensorProto.FLOAT, [1, last.out_features])],
        initializers,
    )
    exported = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 18)], ir_version=10)
    onnx.helper.set_model_props(exported, metadata)
    onnx.checker.check_model(exported, full_check=True)
    onnx.save(exported, out)


def fused(model: GestureCnn) -> dict[str, torch.Tensor]:
    """Weights and biases of the convolutions with their batch normalisation folded in."""
    weights = {}
    for index, block in enumerate(model.eval().features):
        convolution = torch.nn.utils.fusion.fuse_conv_bn_eval(block[0], block[1])
        weights[f"conv{index}.weight"] = convolution.weight
        weights[f"conv{index}.bias"] = convolution.bias
    return weights


def check_parity(model: GestureCnn, windows: np.ndarray, out: Path) -> float:
    """Largest difference of a probability between PyTorch and ONNX Runtime over `windows`."""
    session = onnxruntime.InferenceSession(out, providers=["CPUExecutionProvider"])
    with torch.no_grad():
        expected = torch.softmax(model.eval()(torch.from_numpy(windows)), dim=1).numpy()
    got = np.concatenate([session.run(None, {"window": window[None]})[0] for window in windows])
    return float(np.abs(expected - got).max())


def table(header: list[str], rows: list[list[str]]) -> str:
    """A Markdown table."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def write_card(out: Path, names, metadata, settings: dict, confusion: np.ndarray, people: dict, parity: float):
    """The model card beside OUT, and on the terminal."""
    with np.errstate(invalid="ignore"):
        precision = confusion.diagonal() / confusion.sum(0)
        recall = confusion.diagonal() / confusion.sum(1)
        f1 = 2 * precision * recall / (precision + recall)
    accuracy = confusion.trace() / confusion.sum()
    scores = [
        [name, f"{precision[i]:.3f}", f"{recall[i]:.3f}", f"{f1[i]:.3f}", str(confusion[i].sum())]
        for i, name in enumerate(names)
    ]
    counts = [[f"**{name}**", *map(str, confusion[i])] for i, name in enumerate(names)]
    by_person = [[str(person), f"{share:.3f}", str(count)] for person, (share, count) in people.items()]
    card = f"""# {out.name}

The 1D CNN of the paper: {len(names)} classes ({", ".join(names)}). Input `window` [1, {metadata["tendon.channels"]}, \
{metadata["tendon.window_samples"]}]: the filtered signal in ADC counts, channel-major; output `probabilities` \
[1, {len(names)}]. Z-score and softmax are inside the graph. Written by `training/train.py`.

## Data
3DC data set (Côté-Allard et al. 2019): raw forearm EMG, dry electrodes, 1000 Hz, resampled to 2000 Hz.

{table(["", ""], [[key, str(value)] for key, value in settings.items()])}

## Test on people never seen in training
Accuracy **{accuracy:.4f}** over {confusion.sum()} windows.

{table(["class", "precision", "recall", "F1", "windows"], scores)}

Confusion matrix, one row a true class, one column a predicted class:

{table(["", *names], counts)}

{table(["person", "accuracy", "windows"], by_person)}

## Limits
- Validation windows overlap training windows of the same people (the split of the paper), so the validation
  accuracy says nothing about a new person; the test accuracy does. Expect it to vary greatly between people.
- Rest windows come from recordings of rest only; letting go of a gesture is in no class.
- Amplitudes are those of one armband in ADC counts: another amplifier needs a model trained on its own unit.
- All windows of a file carry its label after onset detection, so some labels are wrong, mostly where a person
  moved late or let go early.
- The paper's accuracy ({PAPER_ACCURACY[len(names)]}, Ozdemir data set, 35 people trained, five held out) was reached on other data and is
  no yardstick for this number.

PyTorch and ONNX Runtime differ by at most {parity:.1e} in a probability.

## Credit
The 3DC data set (LibEMG/3DCDataset): Côté-Allard, U., Fall, C. L., Drouin, A., Campeau-Lecours, A., Gosselin, C.,
Glette, K., Laviolette, F., Gosselin, B.: "Deep learning for electromyographic hand gesture signal classification
using transfer learning", IEEE Transactions on Neural Systems and Rehabilitation Engineering 27(4):760-771, 2019.
"""
    out.with_suffix(".md").write_text(card)
    print(card)


def write_smoke_dataset(folder: Path) -> None:
    """A data set like those of `tendon dataset build`: three people, six gestures told apart by their amplitudes."""
    rng = np.random.default_rng(0)
    labels = np.tile(np.arange(6, dtype=np.uint8), 3 * SMOKE_WINDOWS)
    people = np.repeat(np.array([1, 2, 3], dtype=np.uint16), 6 * SMOKE_WINDOWS)
    amplitudes = rng.uniform(5, 500, (6, 4)).astype(np.float32)
    noise = rng.standard_normal((len(labels), 4, 600), dtype=np.float32)
    np.save(folder / "windows.npy", noise * amplitudes[labels][:, :, None])
    np.save(folder / "labels.npy", labels)
    np.save(folder / "people.npy", people)
    settings = {
        "channels": [0, 1, 2, 3],
        "sample_rate_hz": 2000.0,
        "filter": PAPER_FILTER,
        "input": "raw",
        "windows": {"window_samples": 600, "increment_samples": 150},
    }
    (folder / "manifest.json").write_text(json.dumps({"settings": settings}))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--smoke", action="store_true", help="a tiny run on made-up windows, to see that it works")
    parser.add_argument("--dataset", type=Path, help="folder with windows.npy and manifest.json")
    parser.add_argument("--classes", choices=CLASSES, help="six with rest, five without")
    parser.add_argument("--out", type=Path, help="the .onnx file to write; its card goes beside")
    parser.add_argument("--epochs", type=int, default=30, help="default: %(default)s, the paper's")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--test-people", type=int, nargs="+", default=[19, 20, 22], help="default: %(default)s")
    parser.add_argument("--threads", type=int, default=2, help="CPU threads; default: %(default)s")
    arguments = parser.parse_args()
    if arguments.smoke:
        with tempfile.TemporaryDirectory() as folder:
            write_smoke_dataset(Path(folder))
            arguments.dataset, arguments.out = Path(folder), Path(folder) / "smoke.onnx"
            arguments.classes, arguments.epochs, arguments.test_people = "six", SMOKE_EPOCHS, [3]
            accuracy = run(arguments)
        if accuracy < SMOKE_ACCURACY:
            raise SystemExit(f"smoke: test accuracy {accuracy:.3f}, expected at least {SMOKE_ACCURACY}")
        print("smoke: ok")
        return
    for name in ("dataset", "classes", "out"):
        if getattr(arguments, name) is None:
            parser.error(f"--{name} is missing (or take --smoke)")
    run(arguments)


def run(arguments: argparse.Namespace) -> float:
    """Trains, exports and checks; returns the accuracy on the people held out."""
    torch.set_num_threads(arguments.threads)
    torch.manual_seed(arguments.seed)
    rng = np.random.default_rng(arguments.seed)
    names = CLASSES[arguments.classes]

    made_with = json.loads((arguments.dataset / "manifest.json").read_text())["settings"]
    made_with["filter"] = made_with["filter"] or PAPER_FILTER
    windows = np.load(arguments.dataset / "windows.npy", mmap_mode="r")
    people = np.load(arguments.dataset / "people.npy")
    # A label is the gesture's number; a class is its place in `names`, or negative where it is left out.
    labels = np.load(arguments.dataset / "labels.npy").astype(np.int64) - (len(GESTURES) - len(names))
    used = np.flatnonzero(labels >= 0)
    held_out = np.isin(people[used], arguments.test_people)
    development, test = used[~held_out], used[held_out]
    if len(test) == 0 or len(development) == 0:
        raise SystemExit(f"--test-people {arguments.test_people} leave no windows on one side; found {set(people)}")
    train_part, validation_part = stratified_split(labels[development], rng)
    train_indices, validation_indices = development[train_part], development[validation_part]
    print(f"windows: {len(train_indices)} train, {len(validation_indices)} validation, {len(test)} test", flush=True)

    model, validation_accuracy, best_epoch = train(
        windows, labels, train_indices, validation_indices, len(names), arguments.epochs, rng
    )

    trained_people = sorted(int(person) for person in set(people[development]))
    settings = {
        "people trained on": " ".join(map(str, trained_people)),
        "people held out for test": " ".join(map(str, arguments.test_people)),
        "windows": f"{len(train_indices)} train, {len(validation_indices)} validation, {len(test)} test",
        "channels of the armband": " ".join(map(str, made_with["channels"])),
        "window, increment": f"{windows.shape[2]}, {made_with['windows']['increment_samples']} samples",
        "filter": f"`{json.dumps(made_with['filter'])}`",
        "input": made_with["input"],
        "optimiser": f"Adam {LEARNING_RATE}, weight decay {WEIGHT_DECAY}, batch {BATCH}, cross-entropy, bfloat16 autocast",
        "epochs": f"{arguments.epochs}, best {best_epoch}",
        "seed": arguments.seed,
        "validation accuracy": f"{validation_accuracy:.4f}",
    }
    metadata = {
        "tendon.contract_version": CONTRACT_VERSION,
        "tendon.channels": str(windows.shape[1]),
        "tendon.sample_rate_hz": f"{made_with['sample_rate_hz']:g}",
        "tendon.window_samples": str(windows.shape[2]),
        "tendon.filter": json.dumps(made_with["filter"], separators=(",", ":")),
        "tendon.input": made_with["input"],
        "tendon.classes": ",".join(names),
        "tendon.input_unit": "adc_counts",
        "tendon.normalisation": "z-score, inside the graph",
        "tendon.provenance": (
            f"3DC data set (Cote-Allard et al. 2019); trained on people {settings['people trained on']}; "
            f"held out {settings['people held out for test']}; {settings['windows']} windows; "
            f"epochs {settings['epochs']}; seed {arguments.seed}"
        ),
    }
    export(model, windows.shape[1:], metadata, arguments.out)
    parity = check_parity(model, np.ascontiguousarray(windows[test[:: max(1, len(test) // 256)]]), arguments.out)
    if parity > PARITY_TOLERANCE:
        raise SystemExit(f"{arguments.out}: differs from PyTorch by {parity:.1e}, more than {PARITY_TOLERANCE:.0e}")

    predicted = predict(model, windows, test)
    by_person = {
        person: (float((predicted == labels[test])[people[test] == person].mean()), int((people[test] == person).sum()))
        for person in arguments.test_people
    }
    confusion = confusion_matrix(labels[test], predicted, len(names))
    if not arguments.smoke:
        write_card(arguments.out, names, metadata, settings, confusion, by_person, parity)
    return float(confusion.trace() / confusion.sum())


if __name__ == "__main__":
    main()
