"""Which Gaussians, or anchors, are nearest to places."""

import numpy as np

# meters around places within which centers are looked for first, and places that are looked at together
NEAR_M, BLOCK = 0.006, 64


def nearest_centers(points_m: np.ndarray, centers_m: np.ndarray, count: int) -> np.ndarray:
    """(P, count) numbers of those centers (N, D) that are nearest to each of the points (P, D), in no order; of fewer
    centers all."""
    count = min(count, len(centers_m))
    found = np.empty((len(points_m), count), np.int64)
    boxes = [(np.arange(len(points_m)), np.arange(len(centers_m)), NEAR_M)] if len(points_m) else []
    while boxes:
        some, near, margin_m = boxes.pop()
        low_m, high_m = points_m[some].min(axis=0) - margin_m, points_m[some].max(axis=0) + margin_m
        # what is not finite is in no box: it gets any
        is_inside = ((centers_m[near] >= low_m) & (centers_m[near] <= high_m)).all(axis=1) | np.isinf(margin_m)
        inside = near[is_inside]
        if len(some) > BLOCK:
            some = some[points_m[some, (high_m - low_m).argmax()].argsort()]
            boxes += [(half, inside, margin_m) for half in np.array_split(some, 2)]
            continue
        squares_m2 = ((points_m[some, None] - centers_m[inside]) ** 2).sum(-1)
        if len(inside) == len(centers_m) or (
            len(inside) > count and np.partition(squares_m2, count - 1)[:, count - 1].max() <= margin_m**2
        ):
            found[some] = inside[np.argpartition(squares_m2, count - 1)[:, :count]]
        else:
            boxes.append((some, np.arange(len(centers_m)), 2 * margin_m))
    return found
