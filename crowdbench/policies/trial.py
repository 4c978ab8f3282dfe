"""Script that runs an ONNX file in a separate process, because some files crash onnxruntime.

    python trial.py FILE INPUT=SIZE …

It does not import crowdbench, so that it starts quickly. The actions are checked elsewhere.
"""

import sys

import numpy as np
import onnxruntime


def main() -> None:
    """Run the file for one and for three persons."""
    file, sizes = sys.argv[1], dict(given.split("=") for given in sys.argv[2:])
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    session = onnxruntime.InferenceSession(file, options, providers=["CPUExecutionProvider"])
    for persons in (1, 3):
        fed = {name: np.zeros((persons, int(n)), np.float32) for name, n in sizes.items()}
        session.run(None, fed)


if __name__ == "__main__":
    main()
