"""Makes unlabelled.json beside this file, with NumPy, SciPy and scikit-learn: python make_unlabelled.py

Nothing here shares code or method with the crate: Ward is SciPy's linkage, the chain is run in logarithms, directions are SciPy's
generalised eigenvectors, and every assignment is weighed with the plain formula. Numbers are rounded to 1/64 so that the JSON is
short and exact.
"""

import itertools
import json
import pathlib

import numpy as np
import scipy
import scipy.linalg
import sklearn
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.special import logsumexp
from sklearn.covariance import ledoit_wolf

HERE = pathlib.Path(__file__).parent
FEATURES, GESTURES, PEOPLE, TURNS = 8, 4, 4, (-2, 0, 1)
CLASSES = ["grip", "rest", "flexion", "ulnar"]
ORDER = [1, 0, 2, 3]  # rest first
DIRECTIONS, CLUSTER_DIRECTIONS, BLOCK, STAY, SCALE, ROUNDS, TAU, RIDGE = 40, 20, 6, 0.95, 0.3, 10, 0.25, 0.1


def rounded(values):
    return np.round(64 * values) / 64


def chain(log_likelihoods):
    """Posterior of the states, forward-backward in logarithms."""
    count, states = log_likelihoods.shape
    change = np.full((states, states), np.log((1 - STAY) / (states - 1)))
    np.fill_diagonal(change, np.log(STAY))
    forward, backward = np.zeros((count, states)), np.zeros((count, states))
    forward[0] = log_likelihoods[0] - np.log(states)
    for i in range(1, count):
        forward[i] = logsumexp(forward[i - 1][:, None] + change, axis=0) + log_likelihoods[i]
    for i in range(count - 2, -1, -1):
        backward[i] = logsumexp(change + log_likelihoods[i + 1] + backward[i + 1], axis=1)
    both = forward + backward
    return np.exp(both - logsumexp(both, axis=1, keepdims=True))


def recognise(people, stream, levels):
    offsets, scatter, windows = {}, np.zeros((FEATURES, FEATURES)), 0
    for person in people:
        x, y = np.array(person["features"]).reshape(-1, FEATURES), np.array(person["labels"])
        means = np.array([x[y == c].mean(0) for c in range(GESTURES)])
        offsets.setdefault(person["turn"], []).append((means - means.mean(0))[ORDER])
        if abs(person["turn"]) <= 1:
            apart = x - means[y]
            scatter, windows = scatter + apart.T @ apart, windows + len(x)
    every = np.concatenate([np.array(o).reshape(-1, FEATURES) for o in offsets.values()])
    _, vectors = scipy.linalg.eigh(every.T @ every / len(every), scatter / windows)
    project = vectors[:, ::-1][:, :DIRECTIONS]
    middles = {turn: np.mean(o, axis=0) @ project for turn, o in offsets.items()}
    apart = np.concatenate([(np.array(o) @ project - middles[turn]).reshape(-1, project.shape[1]) for turn, o in offsets.items()])
    between = ledoit_wolf(apart, assume_centered=True)[0] * PEOPLE / (PEOPLE - 1)
    between += RIDGE * np.trace(between) / len(between) * np.eye(len(between))

    z = stream @ project
    first = z[:, :CLUSTER_DIRECTIONS]
    blocks = max(1, round(len(z) / BLOCK))
    of_window = np.arange(len(z)) * blocks // len(z)
    block_means = np.array([first[of_window == b].mean(0) for b in range(blocks)])
    shares = np.eye(GESTURES)[fcluster(linkage(block_means, "ward"), GESTURES, "maxclust")[of_window] - 1]
    for _ in range(ROUNDS):
        means = shares.T @ first / shares.sum(0)[:, None]
        shares = chain(-0.5 * SCALE * ((first[:, None] - means) ** 2).sum(2))
    clusters = shares.T @ z / shares.sum(0)[:, None]
    rest = int((shares.T @ levels / shares.sum(0)).argmin())
    clusters = clusters - clusters.mean(0)
    others = [c for c in range(GESTURES) if c != rest]
    assignments = [[rest, *p] for p in itertools.permutations(others)]
    inverse = np.linalg.inv(between)
    logs = []
    for assignment in assignments:
        places = [clusters[assignment] - middle for middle in middles.values()]
        logs.append(logsumexp([-0.5 * TAU * np.einsum("ci,ij,cj", d, inverse, d) for d in places]))
    weights = np.exp(logs - logsumexp(logs))
    probabilities = np.zeros((GESTURES, GESTURES))
    for weight, assignment in zip(weights, assignments):
        probabilities[np.arange(GESTURES), assignment] += weight
    best = assignments[int(weights.argmax())]
    labels = np.array([best.index(c) for c in shares.argmax(1)])
    return {
        "labels": labels.tolist(),
        "probabilities": (shares * probabilities[labels]).sum(1).tolist(),
        "sureness": float(probabilities[np.arange(GESTURES), best].mean()),
    }


def main():
    random = np.random.default_rng(15)
    gestures = 0.8 * random.normal(size=(len(TURNS), GESTURES, FEATURES))
    mixing = np.eye(FEATURES) + 0.3 * random.normal(size=(FEATURES, FEATURES))
    people = []
    for _ in range(PEOPLE):
        own = random.normal(size=FEATURES)
        for place, turn in enumerate(TURNS):
            labels = np.repeat(np.arange(GESTURES), 6)
            means = own + gestures[place] + 1.0 * random.normal(size=(GESTURES, FEATURES))
            x = rounded(means[labels] + 0.5 * random.normal(size=(len(labels), FEATURES)) @ mixing)
            people.append({"turn": turn, "features": x.ravel().tolist(), "labels": labels.tolist()})
    held = np.repeat([1, 3, 0, 2, 1, 3], [20, 17, 23, 19, 12, 15])
    means = random.normal(size=FEATURES) + gestures[2] + 0.9 * random.normal(size=(GESTURES, FEATURES))
    stream = rounded(means[held] + 0.5 * random.normal(size=(len(held), FEATURES)) @ mixing)
    levels = rounded(np.where(held == 1, 1.0, 2.0) + 0.3 * random.normal(size=len(held)))
    points = rounded(random.normal(size=(40, 3)) + 2 * random.normal(size=(5, 3))[random.integers(5, size=40)])
    ward = [
        {"clusters": clusters, "of_point": fcluster(linkage(points, "ward"), clusters, "maxclust").tolist()}
        for clusters in (2, 5, 11)
    ]
    golden = {
        "made_with": {"numpy": np.__version__, "scipy": scipy.__version__, "scikit-learn": sklearn.__version__},
        "classes": CLASSES,
        "feature_count": FEATURES,
        "people": people,
        "stream": stream.ravel().tolist(),
        "levels": levels.tolist(),
        "recognised": recognise(people, stream, levels),
        "ward": {"points": points.ravel().tolist(), "dimensions": 3, "cuts": ward},
    }
    (HERE / "unlabelled.json").write_text(json.dumps(golden) + "\n")
    truth = np.array([ORDER.index(label) for label in held])
    print("right", (np.array(golden["recognised"]["labels"]) == truth).mean(), "sureness", golden["recognised"]["sureness"])


if __name__ == "__main__":
    main()
