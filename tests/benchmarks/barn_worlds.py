"""Whether the generator makes BARN's kind of worlds: `python -m tests.benchmarks.barn_worlds FOLDER`.

FOLDER has BARN's .world files and, below it, path_files/. Prints the table docs/results/barn_agreement.csv: medians of
fill and difficulty over the 300 built-in worlds and over BARN's, and the two-sample Kolmogorov-Smirnov test.
"""

import sys

import numpy as np
from scipy.stats import ks_2samp

import worlds
from tests.support import barn_metrics as metrics
from worlds import barn


def measure(spec):
    """{"fill" or name of a metric: (n,) of the n worlds of a specification}."""
    found = worlds.load_all(spec)
    rows = [metrics.difficulty(world) for world in found]
    table = {name: np.array([row[name] for row in rows]) for name in metrics.NAMES}
    return {"fill": np.array([barn.fill_of(world.cylinders).mean() for world in found]), **table}


def main():
    train, test, barn = measure("generated:train"), measure("generated:test"), measure(sys.argv[1])
    print("median of,built-in,BARN,KS statistic,p")
    for name, theirs in barn.items():
        ours = np.concatenate([train[name], test[name]])
        agreement = ks_2samp(ours, theirs)
        values = np.median(ours), np.median(theirs), agreement.statistic
        print(name + "".join(f",{value:.3f}" for value in values) + f",{agreement.pvalue:.2f}")


if __name__ == "__main__":
    main()
