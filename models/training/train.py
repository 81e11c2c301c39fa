"""Trains a network of the paper (section "Classification Models") and exports it to ONNX with its contract.

    scripts/train --dataset DIR --classes six       --out models/cnn-six-class.onnx
    scripts/train --dataset DIR --classes five      --out models/cnn-five-gesture.onnx
    scripts/train --dataset DIR --classes rest-move --out models/cnn-rest-move.onnx
    scripts/train --dataset DIR --classes six --network lstm --out lstm.onnx
    scripts/train --smoke

DIR is the output of `tendon dataset build --test-people P,…`: windows that went through the same filters, onset detection
and windowing as the live pipeline. The data set says which windows are for training, validation and test. The test people
are never seen in training; with `--test-sessions` or `--test-repetitions`, a part of people that is held out. The epoch with the best validation accuracy is exported. A model of envelopes
(`dataset build --input envelope`) or an LSTM can be evaluated, but not run live.

Beside OUT this writes the model card (OUT with the ending .md) and prints the same numbers. An interrupted training
continues where it was when the same command is given again (OUT with the ending .checkpoint). A model that stands at OUT
is replaced with --force only, and only once the new one is complete.

--smoke trains a tiny model on generated windows to check that everything works: training, resuming after an
interruption, export, parity with ONNX Runtime. It keeps nothing.
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import onnxruntime
import torch
from torch import nn

from card import OWN_UNIT, source, write_card
from data import CLASS_SETS, GESTURES, PAPER_FILTER, SEQUENCE_WINDOWS, Dataset, class_names
from networks import NETWORKS, GestureLstm, export

CONTRACT_VERSION = "1"
BATCH = 128
LEARNING_RATE = 1e-3
WEIGHT_DECAY = 1e-4
PARITY_TOLERANCE = 1e-4
# For --smoke: windows per gesture and person, epochs, and the test accuracy that proves that it learned.
SMOKE_WINDOWS = 120
SMOKE_EPOCHS = 4
SMOKE_ACCURACY = 0.9


@torch.no_grad()
def predict(model: nn.Module, dataset: Dataset, newest: np.ndarray, device: torch.device) -> np.ndarray:
    """Predicted class of each example, in their order; -1 where the outputs are not finite: no answer."""
    model.eval()
    batches = (newest[start : start + 512] for start in range(0, len(newest), 512))
    examples = (torch.from_numpy(dataset.examples(batch)).to(device) for batch in batches)
    outputs = (model(batch) for batch in examples)
    classes = (torch.where(output.isfinite().all(1), output.argmax(1), -1) for output in outputs)
    return np.concatenate([batch.cpu().numpy() for batch in classes])


def show_progress(text: str) -> None:
    """A progress line that the next one replaces."""
    if sys.stderr.isatty():
        print(f"\r{text}\x1b[K", end="", file=sys.stderr, flush=True)


def train(model: nn.Module, dataset: Dataset, arguments, device: torch.device, stop_after: int | None = None):
    """Trains `model` and keeps the epoch with the best validation accuracy; returns that accuracy and epoch.

    Every epoch has its own random numbers, so a training resumed from a checkpoint ends the same as one without a
    break. After `stop_after` epochs it stops, as if interrupted.
    """
    optimiser = torch.optim.Adam(model.parameters(), lr=LEARNING_RATE, weight_decay=WEIGHT_DECAY)
    criterion = nn.CrossEntropyLoss()
    # A training resumes only from a checkpoint that was made with the same.
    made_with = {
        "settings": dataset.settings,
        "windows": [len(dataset.training), len(dataset.validation), len(dataset.test)],
        "people": sorted(set(dataset.people[dataset.training].tolist())),
        "classes": arguments.classes,
        "network": model.name,
        "epochs": arguments.epochs,
        "seed": arguments.seed,
    }
    best = {"accuracy": -1.0, "epoch": 0, "model": None}
    first_epoch = 1
    checkpoint = arguments.out.with_suffix(".checkpoint")
    if checkpoint.is_file():
        kept = torch.load(checkpoint, map_location=device, weights_only=True)
        if kept["made_with"] == made_with:
            model.load_state_dict(kept["model"])
            optimiser.load_state_dict(kept["optimiser"])
            best, first_epoch = kept["best"], kept["epoch"] + 1
            print(f"{checkpoint}: resuming after epoch {kept['epoch']}", flush=True)
        else:
            print(f"{checkpoint}: belongs to another training; starting over", flush=True)
    for epoch in range(first_epoch, arguments.epochs + 1):
        started = time.monotonic()
        torch.manual_seed(arguments.seed * 10_000 + epoch)
        order = np.random.default_rng([arguments.seed, epoch]).permutation(dataset.training)
        model.train()
        loss_sum = 0.0
        for start in range(0, len(order), BATCH):
            batch = order[start : start + BATCH]
            examples = torch.from_numpy(dataset.examples(batch)).to(device)
            labels = torch.from_numpy(dataset.labels[batch]).to(device)
            optimiser.zero_grad()
            # Half the time of float32 on processors that support it; weights and validation stay float32.
            with torch.autocast(device.type, torch.bfloat16, enabled=model.name == "cnn"):
                logits = model(examples)
            loss = criterion(logits.float(), labels)
            loss.backward()
            optimiser.step()
            loss_sum += loss.item() * len(batch)
            show_progress(f"epoch {epoch}/{arguments.epochs}: {100 * start // len(order)} %")
        show_progress("")
        predicted = predict(model, dataset, dataset.validation, device)
        accuracy = float((predicted == dataset.labels[dataset.validation]).mean())
        print(
            f"epoch {epoch:2d}/{arguments.epochs}  loss {loss_sum / len(order):.4f}  validation {accuracy:.4f}  "
            f"{time.monotonic() - started:.0f} s",
            flush=True,
        )
        if accuracy > best["accuracy"]:
            weights = {name: value.clone() for name, value in model.state_dict().items()}
            best = {"accuracy": accuracy, "epoch": epoch, "model": weights}
        state = {"made_with": made_with, "epoch": epoch, "best": best}
        state |= {"model": model.state_dict(), "optimiser": optimiser.state_dict()}
        partial = checkpoint.with_suffix(".checkpoint-partial")
        torch.save(state, partial)
        partial.replace(checkpoint)
        if epoch == stop_after:
            break
    model.load_state_dict(best["model"])
    return best["accuracy"], best["epoch"]


def check_parity(model: nn.Module, examples: np.ndarray, out: Path) -> float:
    """Largest difference of a probability between PyTorch and ONNX Runtime over `examples`."""
    session = onnxruntime.InferenceSession(out, providers=["CPUExecutionProvider"])
    with torch.no_grad():
        expected = torch.softmax(model.cpu().eval()(torch.from_numpy(examples)), dim=1).numpy()
    got = np.concatenate([session.run(None, {"window": example[None]})[0] for example in examples])
    return float(np.abs(expected - got).max())


def write_smoke_dataset(folder: Path) -> None:
    """A data set like those of `tendon dataset build`: three people, six gestures that differ in their amplitudes."""
    rng = np.random.default_rng(0)
    labels = np.repeat(np.tile(np.arange(6, dtype=np.uint8), 3), SMOKE_WINDOWS)
    people = np.repeat(np.array([1, 2, 3], dtype=np.uint16), 6 * SMOKE_WINDOWS)
    splits = np.where(people == 3, 2, np.arange(len(labels)) % 5 == 0).astype(np.uint8)
    amplitudes = rng.uniform(5, 500, (6, 4)).astype(np.float32)
    noise = np.abs(rng.standard_normal((len(labels), 4, 600), dtype=np.float32))
    windows = noise * amplitudes[labels][:, :, None]
    np.save(folder / "windows.npy", windows)
    np.save(folder / "labels.npy", labels)
    np.save(folder / "people.npy", people)
    np.save(folder / "splits.npy", splits)
    np.save(folder / "recordings.npy", (np.arange(len(labels)) // SMOKE_WINDOWS).astype(np.uint32))
    settings = {
        "channels": [0, 1, 2, 3],
        "sample_rate_hz": 2000.0,
        "filter": PAPER_FILTER,
        "input": "envelope",
        "windows": {"window_samples": 600, "increment_samples": 150},
    }
    per_gesture = {}
    for label, name in enumerate(GESTURES):
        own = windows[(labels == label) & (splits == 0)].astype(np.float64)
        sums = {"sum": own.sum(axis=(0, 2)).tolist(), "sum_of_squares": (own**2).sum(axis=(0, 2)).tolist()}
        per_gesture[name] = {"windows": len(own)} | sums
    manifest = {"settings": settings, "classes": GESTURES, "training_statistics": {"per_gesture": per_gesture}}
    (folder / "manifest.json").write_text(json.dumps(manifest))


def smoke(arguments) -> None:
    """Trains both networks, the first with an interruption."""
    with tempfile.TemporaryDirectory() as folder:
        arguments.dataset = Path(folder)
        write_smoke_dataset(arguments.dataset)
        for network, classes, stop_after in (("cnn", "six", SMOKE_EPOCHS // 2), ("lstm", "rest-move", None)):
            arguments.network, arguments.classes = network, classes
            arguments.epochs, arguments.out = SMOKE_EPOCHS, Path(folder) / f"{network}.onnx"
            if stop_after:
                run(arguments, stop_after)
            accuracy = run(arguments)
            if accuracy < SMOKE_ACCURACY:
                raise SystemExit(f"smoke: {network}: test accuracy {accuracy:.3f}, expected at least {SMOKE_ACCURACY}")
    print("smoke: ok")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--smoke", action="store_true", help="a tiny run on generated windows, to check that everything works")
    parser.add_argument("--dataset", type=Path, help="folder that `tendon dataset build --test-people` wrote")
    sets = ", ".join(CLASS_SETS)
    parser.add_argument("--classes", help=f"{sets}, or names of gestures: {','.join(GESTURES[1:3])}")
    parser.add_argument("--network", choices=NETWORKS, default="cnn", help="default: %(default)s")
    parser.add_argument("--out", type=Path, help="the .onnx file to write; its card goes beside it")
    parser.add_argument("--force", action="store_true", help="replace the model that stands at --out")
    parser.add_argument("--epochs", type=int, default=30, help="default: %(default)s, the paper's")
    parser.add_argument("--seed", type=int, default=0, help="of the initial weights and the order of the windows (default: %(default)s)")
    parser.add_argument("--device", choices=["auto", "cpu", "cuda"], default="auto", help="default: CUDA if available")
    parser.add_argument("--threads", type=int, default=2, help="CPU threads; default: %(default)s")
    arguments = parser.parse_args()
    if arguments.smoke:
        smoke(arguments)
        return
    for name in ("dataset", "classes", "out"):
        if getattr(arguments, name) is None:
            parser.error(f"--{name} is missing (or use --smoke)")
    try:
        class_names(arguments.classes)
    except ValueError as error:
        parser.error(f"--classes: {error}")
    if arguments.out.exists() and not arguments.force:
        parser.error(f"{arguments.out} is there already: add --force to replace it, or choose another file")
    run(arguments)


def run(arguments, stop_after: int | None = None) -> float:
    """Trains, exports and checks; returns the accuracy on the people held out."""
    torch.set_num_threads(arguments.threads)
    # Closed gates produce numbers so small that processors slow down.
    torch.set_flush_denormal(True)
    torch.manual_seed(arguments.seed)
    is_cuda = arguments.device == "cuda" or arguments.device == "auto" and torch.cuda.is_available()
    device = torch.device("cuda" if is_cuda else "cpu")
    names = class_names(arguments.classes)
    network = NETWORKS[arguments.network]
    dataset = Dataset(arguments.dataset, names, SEQUENCE_WINDOWS if network is GestureLstm else 1)
    counts = f"{len(dataset.training)} training, {len(dataset.validation)} validation, {len(dataset.test)} test"
    print(f"{'sequences' if dataset.sequence_windows > 1 else 'windows'}: {counts}", flush=True)

    mean, std = (torch.from_numpy(values) for values in dataset.channel_statistics())
    channels, samples = dataset.windows.shape[1:]
    model = network(mean, std, samples, len(names)).to(device)
    validation_accuracy, best_epoch = train(model, dataset, arguments, device, stop_after)

    made_with = dataset.settings
    people_trained = " ".join(map(dataset.who, sorted(set(dataset.people[dataset.training].tolist()))))
    tested = set(dataset.people[dataset.test].tolist()) - set(dataset.people[dataset.training].tolist())
    people_held_out = " ".join(map(dataset.who, sorted(tested)))
    split = dataset.manifest.get("split", {})
    held_out = split.get("held_out") or f"people {people_held_out}"
    recipe = {
        "people trained on": people_trained,
        "held out for test": held_out,
        "sequences of five windows" if dataset.sequence_windows > 1 else "windows": counts,
        "channels of the recordings": ", ".join(dataset.channel_names),
        "window, increment": f"{samples}, {made_with['windows']['increment_samples']} samples",
        "filter": f"`{json.dumps(made_with['filter'])}`",
        "input": made_with["input"],
        "optimiser": f"Adam {LEARNING_RATE}, weight decay {WEIGHT_DECAY}, batch {BATCH}, cross-entropy"
        + (", bfloat16 autocast" if model.name == "cnn" else ""),
        "epochs": f"{arguments.epochs}, best {best_epoch}",
        "seed": arguments.seed,
        "validation accuracy": f"{validation_accuracy:.4f}",
    }
    metadata = {
        "tendon.contract_version": CONTRACT_VERSION,
        "tendon.network": model.name,
        "tendon.channels": str(channels),
        "tendon.sample_rate_hz": f"{made_with['sample_rate_hz']:g}",
        "tendon.window_samples": str(samples),
        "tendon.sequence_windows": str(dataset.sequence_windows),
        "tendon.filter": json.dumps(made_with["filter"], separators=(",", ":")),
        "tendon.input": made_with["input"],
        "tendon.classes": ",".join(names),
        "tendon.normalisation": "z-score, inside the graph",
        "tendon.people_trained": people_trained,
        "tendon.people_held_out": people_held_out,
        "tendon.validation_accuracy": f"{validation_accuracy:.4f}",
        "tendon.provenance": (
            f"trained on people {people_trained}; held out {held_out}; {counts} windows; "
            f"epochs {recipe['epochs']}; seed {arguments.seed}"
        ),
    }
    metadata["tendon.channel_names"] = json.dumps(dataset.channel_names, separators=(",", ":"))
    unit = dataset.manifest.get("unit") or source(dataset.manifest)[1]
    if unit != OWN_UNIT:
        metadata["tendon.unit"] = unit
    if (rest_rms := dataset.rest_rms()) is not None:
        metadata["tendon.rest_rms"] = json.dumps([float(f"{value:.4g}") for value in rest_rms], separators=(",", ":"))
    # People have their numbers within a data set; those of recordings of your own mean nothing elsewhere.
    metadata["tendon.data_set"] = dataset.manifest.get("data_set") or "own recordings"
    if split.get("test_sessions"):
        metadata["tendon.held_out_sessions"] = json.dumps(split["test_sessions"])
    if split.get("test_repetitions"):
        metadata["tendon.held_out_repetitions"] = json.dumps(split["test_repetitions"])
    partial = arguments.out.with_suffix(".partial.onnx")
    export(model.cpu(), dataset.shape, metadata, partial)
    sample = dataset.test[:: max(1, len(dataset.test) // 256)]
    parity = check_parity(model, np.ascontiguousarray(dataset.examples(sample)), partial)
    if parity > PARITY_TOLERANCE:
        partial.unlink()
        raise SystemExit(f"{arguments.out}: differs from PyTorch by {parity:.1e}, more than {PARITY_TOLERANCE:.0e}")

    partial.replace(arguments.out)
    predicted = predict(model, dataset, dataset.test, torch.device("cpu"))
    truth, people = dataset.labels[dataset.test], dataset.people[dataset.test]
    if not arguments.smoke:
        write_card(
            arguments.out, model.name, names, dataset.shape, recipe, dataset.manifest, truth, predicted, people, parity
        )
    if stop_after is None:
        arguments.out.with_suffix(".checkpoint").unlink()
    return float((predicted == truth).mean())


if __name__ == "__main__":
    main()
