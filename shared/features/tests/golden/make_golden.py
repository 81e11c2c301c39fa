"""Makes golden.json beside this file, with NumPy, SciPy and scikit-learn: python make_golden.py

Windows are sums of filtered noise, mixed across channels, rounded to 1/8 so that the JSON holds every f32 exactly. Nothing here
shares code or method with the crate: Z is stacked and multiplied, the logarithm is SciPy's logm, the covariance is
scikit-learn's ledoit_wolf, the discriminant is the plain formula.
"""

import json
import pathlib

import numpy as np
import scipy
import scipy.linalg
import scipy.optimize
import scipy.signal
import scipy.special
import sklearn
from sklearn.covariance import ledoit_wolf

HERE = pathlib.Path(__file__).parent
RIDGE = 0.001
PIECE_MS = 75
PRIOR_S = 9.0
INCREMENT_S = 0.075


def window(random, channels, samples, gain):
    noise = scipy.signal.lfilter([1.0, 0.6, 0.2], [1.0, -0.5], random.normal(size=(channels, samples + 50)))[:, 50:]
    mixing = np.eye(channels) + 0.4 * random.normal(size=(channels, channels))
    return np.round(8 * gain * mixing @ noise) / 8


def features(x, delays, floor, rate_hz):
    """The mean over pieces of about 75 ms."""
    samples = x.shape[1]
    pieces = int(np.floor(samples / (PIECE_MS * rate_hz / 1000) + 0.5))
    pieces = max(1, min(pieces, samples // (2 * max(delays) + 1)))
    borders = [piece * samples // pieces for piece in range(pieces + 1)]
    parts = [x[:, start:end] for start, end in zip(borders, borders[1:])]
    return np.mean([features_of_piece(part, delays, floor) for part in parts], axis=0)


def features_of_piece(x, delays, floor):
    longest = max(delays)
    samples = x.shape[1] - longest
    z = np.concatenate([x[:, longest - delay : longest - delay + samples] for delay in delays])
    c = z @ z.T / samples
    c += (RIDGE * np.trace(c) / len(c) + floor) * np.eye(len(c))
    log = scipy.linalg.logm(c)
    log = (log + log.T) / 2
    rows, columns = np.triu_indices(len(c))
    return log[rows, columns] * np.where(rows == columns, 1, np.sqrt(2))


def feature_cases(random):
    cases = []
    for channels, delays_ms, rate_hz, samples, gain, used in (
        (4, [0, 1, 2, 3], 2000, 120, 30, [0, 2, 4, 6]),
        (4, [0, 1, 2.5], 2000, 600, 5, [0, 2, 5]),
        (1, [0, 1, 2, 3], 1000, 60, 300, [0, 1, 2, 3]),
        (2, [0, 1, 2, 3], 500, 300, 1, [0, 1, 2]),
        (3, [0, 1, 2, 3], 2000, 13, 20, [0, 2, 4, 6]),
        (10, [0, 1, 2, 3], 1259, 70, 10, [0, 1, 3]),
        (33, [0, 1, 2, 3], 2000, 50, 10, [0]),
    ):
        x = window(random, channels, samples, gain)
        cases.append(
            {
                "channels": channels,
                "delays_ms": delays_ms,
                "rate_hz": rate_hz,
                "floor_variance": 0.5,
                "window": x.ravel().tolist(),
                "features": features(x, used, 0.5, rate_hz).tolist(),
            }
        )
    return cases


def softmax(scores):
    return np.exp(scores - scipy.special.logsumexp(scores, axis=1, keepdims=True))


def drawn(means, population, repetitions):
    """u + M + B (B + R / k)^-1 (mean - u - M), u the mean over classes."""
    offsets, between, within = population
    person = (means - offsets).mean(0)
    gain = between @ np.linalg.inv(between + within / repetitions)
    return person + offsets + (means - offsets - person) @ gain.T


def scores_of(x, labels, weights, prior, prior_s, scored, population=None, repetitions=1):
    """The plain formula: mu^T S^-1 x - mu^T S^-1 mu / 2 + ln(share)."""
    prior_weight = prior_s / (prior_s + len(x) * INCREMENT_S)
    shares = np.array(weights) / np.sum(weights)
    means = np.array([x[labels == label].mean(0) for label in range(len(weights))])
    counts = np.bincount(labels)
    centred = (x - means[labels]) * np.sqrt(len(x) * shares / counts)[labels, None]
    own, shrinkage = ledoit_wolf(centred, assume_centered=True)
    covariance = (1 - prior_weight) * own + prior_weight * prior
    if population is not None:
        means = drawn(means, population, repetitions)
    solved = np.linalg.solve(covariance, means.T)
    scores = scored @ solved - 0.5 * (means.T * solved).sum(0) + np.log(shares)
    inverse = np.linalg.inv(covariance)
    apart = scored[:, None, :] - means[None]
    distances = np.sqrt(np.einsum("nci,ij,ncj->nc", apart, inverse, apart).min(1))
    return own, shrinkage, scores, distances


def people_of(random, length):
    """People who make three gestures four times each, some windows every time."""
    gestures = np.round(2 * random.normal(size=(3, length)), 6)
    people = []
    for _ in range(4):
        own = gestures + 0.7 * random.normal(size=(3, length)) + 3 * random.normal(size=length)
        labels = np.repeat(np.arange(3), 20)
        blocks = np.tile(np.repeat(np.arange(4), 5), 3)
        shift = 0.5 * random.normal(size=(3, 4, length))
        x = np.round(own[labels] + shift[labels, blocks] + random.normal(size=(60, length)), 6)
        people.append((x, labels, blocks))
    return people


def population_of(people):
    length = people[0][0].shape[1]
    means, deviations = [], []
    for x, labels, blocks in people:
        repetitions = np.array([[x[(labels == c) & (blocks == r)].mean(0) for r in range(4)] for c in range(3)])
        means.append(repetitions.mean(1))
        deviations.append((repetitions - repetitions.mean(1, keepdims=True)) * np.sqrt(4 / 3))
    means = np.array(means)
    centred = means - means.mean(1, keepdims=True)
    offsets = centred.mean(0)
    apart = (centred - offsets) * np.sqrt(len(people) / (len(people) - 1) * 3 / 2)
    between, _ = ledoit_wolf(apart.reshape(-1, length), assume_centered=True)
    within, _ = ledoit_wolf(np.array(deviations).reshape(-1, length), assume_centered=True)
    return offsets, between, within


def discriminant(random):
    length, weights = 6, [1.0, 1.0, 2.0]
    counts = [9, 14, 25]
    labels = np.repeat(np.arange(3), counts)
    blocks = np.concatenate([np.arange(count) % 3 for count in counts])
    spread = random.normal(size=(length, length))
    x = 0.9 * random.normal(size=(3, length))[labels] + random.normal(size=(len(labels), length)) @ spread
    x = np.round(x, 6)
    other = np.round(random.normal(size=(500, length)) @ (spread + 0.3 * random.normal(size=(length, length))), 6)
    # Pooled about the one mean.
    other_centred = other - other.mean(0)
    prior = other_centred.T @ other_centred / len(other)
    scored = np.round(2 * random.normal(size=(5, length)), 6)
    people = people_of(random, length)
    result = {
        "weights": weights,
        "feature_count": length,
        "features": x.ravel().tolist(),
        "labels": labels.tolist(),
        "blocks": blocks.tolist(),
        "others": other.ravel().tolist(),
        "scored": scored.ravel().tolist(),
        "temperature": 2.5,
        "increment_s": INCREMENT_S,
        "people": [
            {"features": own.ravel().tolist(), "labels": own_labels.tolist(), "blocks": own_blocks.tolist()}
            for own, own_labels, own_blocks in people
        ],
        "fits": [],
    }
    for prior_s, population in ((0.0, None), (PRIOR_S, None), (PRIOR_S, population_of(people))):
        own, shrinkage, scores, distances = scores_of(x, labels, weights, prior, prior_s, scored, population, 3)
        held_out = np.zeros((len(x), 3))
        for block in range(3):
            train, test = blocks != block, blocks == block
            held_out[test] = scores_of(x[train], labels[train], weights, prior, prior_s, x[test], population, 2)[2]
        sample_weights = (np.array(weights) / np.sum(weights) / np.bincount(labels))[labels]

        def loss(log_temperature):
            log_posterior = scipy.special.log_softmax(held_out / np.exp(log_temperature), axis=1)
            return -(sample_weights * log_posterior[np.arange(len(x)), labels]).sum()

        best = scipy.optimize.minimize_scalar(loss, bounds=(np.log(0.01), np.log(1000)), method="bounded",
                                              options={"xatol": 1e-10})
        confusion = np.zeros((3, 3), int)
        np.add.at(confusion, (labels, held_out.argmax(1)), 1)
        result["fits"].append(
            {
                "prior_s": prior_s,
                "has_population": population is not None,
                "shrinkage": shrinkage,
                "own": own.ravel().tolist(),
                "posteriors": softmax(scores / 2.5).ravel().tolist(),
                "distances": distances.tolist(),
                "best_temperature": float(np.exp(best.x)),
                "log_loss_at_1": loss(0.0),
                "log_loss_at_best": float(best.fun),
                "confusion": confusion.tolist(),
            }
        )
    return result


def ledoit_wolf_cases(random):
    cases = []
    for windows, length in ((40, 5), (8, 12), (2, 3)):
        x = np.round(random.normal(size=(windows, length)) @ random.normal(size=(length, length)), 6)
        covariance, shrinkage = ledoit_wolf(x, assume_centered=True)
        cases.append(
            {
                "feature_count": length,
                "centred": x.ravel().tolist(),
                "shrinkage": float(shrinkage),
                "covariance": covariance.ravel().tolist(),
            }
        )
    return cases


def main():
    random = np.random.default_rng(12)
    golden = {
        "made_with": f"numpy {np.__version__}, scipy {scipy.__version__}, scikit-learn {sklearn.__version__}",
        "features": feature_cases(random),
        "ledoit_wolf": ledoit_wolf_cases(random),
        "discriminant": discriminant(random),
    }
    (HERE / "golden.json").write_text(json.dumps(golden) + "\n")


main()
