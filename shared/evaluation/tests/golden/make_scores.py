"""Makes scores.json: answers of a made-up classifier and what scikit-learn says of them.

    python make_scores.py        # scikit-learn 1.9.1, NumPy 2
"""

import json
import warnings
from pathlib import Path

import numpy as np
from sklearn.metrics import accuracy_score, confusion_matrix, log_loss, precision_recall_fscore_support

warnings.filterwarnings("ignore")


def case(seed: int, classes: int, windows: int, skill: float, absent: int | None = None) -> dict:
    rng = np.random.default_rng(seed)
    known = [label for label in range(classes) if label != absent]
    truth = rng.choice(known, windows)
    logits = rng.normal(size=(windows, classes)) + skill * np.eye(classes)[truth]
    probabilities = np.exp(logits)
    probabilities = (probabilities / probabilities.sum(1, keepdims=True)).astype(np.float32)
    predicted = probabilities.argmax(1)
    labels = list(range(classes))

    def scores(average):
        return [float(value) for value in precision_recall_fscore_support(truth, predicted, average=average, zero_division=0)[:3]]

    per_class = precision_recall_fscore_support(truth, predicted, labels=labels, zero_division=0)
    return {
        "truth": truth.tolist(),
        "probabilities": [[float(value) for value in row] for row in probabilities],
        "accuracy": float(accuracy_score(truth, predicted)),
        # In float64: scikit-learn would otherwise sum in float32.
        "loss": float(log_loss(truth, probabilities.astype(np.float64), labels=labels)),
        "per_class": [[float(score[label]) for score in per_class[:3]] + [int(per_class[3][label])] for label in labels],
        "macro": scores("macro"),
        "weighted": scores("weighted"),
        "confusion": confusion_matrix(truth, predicted, labels=labels).tolist(),
    }


cases = [case(0, 6, 120, 1.5), case(1, 5, 90, 0.5), case(2, 6, 60, 3.0, absent=4)]
Path(__file__).with_name("scores.json").write_text(json.dumps(cases, separators=(",", ":")) + "\n")
