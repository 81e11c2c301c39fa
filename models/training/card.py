"""The card that goes beside a model: its data, its recipe, its scores, its limits."""

from pathlib import Path

import numpy as np

THREE_DC = """3DC data set (Côté-Allard et al. 2019): raw forearm EMG, dry electrodes, 1000 Hz, resampled to 2000 Hz."""
THREE_DC_CREDIT = """The 3DC data set (LibEMG/3DCDataset): Côté-Allard, U., Fall, C. L., Drouin, A., Campeau-Lecours, A., Gosselin, C.,
Glette, K., Laviolette, F., Gosselin, B.: "Deep learning for electromyographic hand gesture signal classification
using transfer learning", IEEE Transactions on Neural Systems and Rehabilitation Engineering 27(4):760-771, 2019."""
OZDEMIR = "Ozdemir data set (Ozdemir et al. 2022): forearm EMG of four channels, mV, 2000 Hz."
OZDEMIR_CREDIT = """The data set of hand gestures by Ozdemir, M. A., Kisa, D. H., Guren, O., Akan, A. (Mendeley Data, ckwc76xr2z, 2022),
CC BY."""
OWN = "Recordings of your own, in their own unit."
OWN_UNIT = "the recordings' unit"
OWN_CREDIT = "Those who made the recordings, and the people who were recorded."


def source(manifest: dict) -> tuple[str, str, str]:
    """What the recordings are, their unit, and whom to credit, derived from the names of their files."""
    names = [Path(entry["file"]).name.lower() for entry in manifest.get("recordings", [])]
    if names and all(name.startswith("3dc_emg_gesture_") for name in names):
        return THREE_DC, "ADC counts", THREE_DC_CREDIT
    if names and all(name.endswith(".mat") for name in names):
        return OZDEMIR, "mV", OZDEMIR_CREDIT
    return OWN, manifest.get("unit") or OWN_UNIT, OWN_CREDIT


# Test accuracy in the paper, by network and number of classes; of the raw signal.
PAPER_ACCURACY = {("cnn", 6): 0.8646, ("cnn", 5): 0.9055, ("lstm", 6): 0.7032}


def table(header: list[str], rows: list[list[str]]) -> str:
    """A Markdown table."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def write_card(
    out: Path,
    network: str,
    names: list[str],
    shape: tuple[int, ...],
    recipe: dict,
    manifest: dict,
    truth: np.ndarray,
    predicted: np.ndarray,
    people: np.ndarray,
    parity: float,
) -> None:
    """Writes the model card beside OUT and prints it; `truth`, `predicted` and `people` are those of the test windows."""
    classes = len(names)
    # One row per true class, one column per predicted class.
    answered = predicted >= 0
    confusion = np.bincount(truth[answered] * classes + predicted[answered], minlength=classes**2).reshape(classes, classes)
    support = np.bincount(truth, minlength=classes)
    with np.errstate(invalid="ignore"):
        precision = confusion.diagonal() / confusion.sum(0)
        recall = confusion.diagonal() / support
        f1 = 2 * precision * recall / (precision + recall)
    scores = [
        [name, f"{precision[i]:.3f}", f"{recall[i]:.3f}", f"{f1[i]:.3f}", str(support[i])]
        for i, name in enumerate(names)
    ]
    counts = [[f"**{name}**", *map(str, confusion[i])] for i, name in enumerate(names)]
    by_person = [
        [manifest.get("named_people", {}).get(str(person), str(person)), f"{(predicted == truth)[people == person].mean():.3f}", str((people == person).sum())]
        for person in sorted(set(people.tolist()))
    ]
    paper = PAPER_ACCURACY.get((network, classes)) if "move" not in names and "raw" == recipe["input"] else None
    yardstick = (
        f"\n- The paper's accuracy ({paper}, Ozdemir data set, 35 people trained, five held out) was reached on other"
        " data and\n  cannot be compared with this number."
        if paper
        else ""
    )
    data, unit, credit = source(manifest)
    what = {"cnn": "1D CNN", "lstm": "LSTM"}[network]
    # Whom or what the test windows are of.
    split = manifest.get("split", {})
    is_part = split.get("test_sessions") or split.get("test_repetitions")
    test = (
        f"Test on what was held out: {recipe['held out for test']}" if is_part else "Test on people never seen in training"
    )
    card = f"""# {out.name}

The {what} of the paper: {classes} classes ({", ".join(names)}). Input `window` {[1, *shape]}: the signal in {unit}, \
channel-major; output `probabilities` [1, {classes}]. Z-score and softmax are inside the graph. Written by \
`training/train.py`.

## Data
{data}

{table(["", ""], [[key, str(value)] for key, value in recipe.items()])}

## {test}
Accuracy **{confusion.trace() / len(truth):.4f}** over {len(truth)} examples.

{table(["class", "precision", "recall", "F1", "examples"], scores)}

Confusion matrix, one row per true class, one column per predicted class:

{table(["", *names], counts)}

{table(["person", "accuracy", "examples"], by_person)}

## Limits
- Validation windows overlap training windows of the same people (the paper's split), so the validation accuracy says
  nothing about a new person. The test accuracy does. Expect it to vary greatly between people.
- Rest windows come from recordings of rest only. No class covers the moment of letting go of a gesture.
- Amplitudes are those of one kind of amplifier, in {unit}. Another one needs a model trained on its own unit.
- After onset detection, all windows of a file carry its label. Some labels are therefore wrong, mostly where a person
  moved late or let go early.{yardstick}

PyTorch and ONNX Runtime differ by at most {parity:.1e} in a probability.

## Credit
{credit}
"""
    out.with_suffix(".md").write_text(card)
    print(card)
