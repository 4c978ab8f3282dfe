"""Script that runs an ONNX file in a separate process, because some files crash onnxruntime.

    python trial.py FILE INPUTS NOISE

It does not import crowdbench, so that it starts quickly. The actions are checked elsewhere.
"""

import sys

import numpy as np
import onnxruntime


def main() -> None:
    """Run the file for one and for three persons."""
    file, inputs, noise = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    session = onnxruntime.InferenceSession(file, options, providers=["CPUExecutionProvider"])
    for persons in (1, 3):
        fed = {"observation": np.zeros((persons, inputs), np.float32)}
        if noise:
            fed["noise"] = np.zeros((persons, noise), np.float32)
        session.run(["action"], fed)


if __name__ == "__main__":
    main()
