#!/usr/bin/env python3
"""Writes raptor_weights.h, the weights of the neural policy RAPTOR, for raptor.c; with --check, tests a library built of both.

examples/raptor/weights.py                         downloads foundation-policy 1.0.2 from PyPI (MIT licence)
examples/raptor/weights.py --check ./libraptor.so  compares its forward pass with rl-tools and, if installed, the package

Without a network, put the package's source archive next to this file first.
"""

import ctypes, hashlib, io, pathlib, random, struct, subprocess, sys, tarfile

HERE = pathlib.Path(__file__).resolve().parent
ARCHIVE = HERE / "foundation_policy-1.0.2.tar.gz"
PACKAGE = "foundation-policy==1.0.2"
SHA_256 = "fd869d9603da60eaddbec08f212d32b1e23ca279ff56994a871a89dc1d2242f6"
CHECKPOINT = "foundation_policy-1.0.2/foundation_policy/blob/checkpoint.h5"
# Offset [bytes] and length of the arrays in that very file: HDF5, contiguous, little-endian f32, row by row.
ARRAYS = {
    "dense_weight": (9896, 16 * 22), "dense_bias": (11304, 16),
    "gru_input_weight": (16056, 48 * 16), "gru_input_bias": (11368, 48),
    "gru_hidden_weight": (22112, 48 * 16), "gru_hidden_bias": (11560, 48), "gru_initial": (11752, 16),
    "output_weight": (30848, 4 * 16), "output_bias": (11816, 4),
}
# Inputs and outputs of two sequences of 500 steps, computed by rl-tools: 500 x 2 x 22 and 500 x 2 x 4.
INPUT, OUTPUT, STEPS = 35976, 126024, 500


def checkpoint():
    if not ARCHIVE.exists():
        download = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--no-binary", ":all:", "--dest", HERE, PACKAGE]
        if subprocess.run(download).returncode or not ARCHIVE.exists():
            sys.exit(f"cannot download {PACKAGE}: without a network, put {ARCHIVE.name} into {HERE}")
    content = ARCHIVE.read_bytes()
    found = hashlib.sha256(content).hexdigest()
    if found != SHA_256:
        sys.exit(f"{ARCHIVE}: its SHA-256 is {found}, that of the package is {SHA_256}: remove the file and run this again")
    return tarfile.open(fileobj=io.BytesIO(content)).extractfile(CHECKPOINT).read()


def floats(offset, count):
    return struct.unpack_from(f"<{count}f", h5, offset)


def compare(what, inputs, outputs):
    hidden, action, worst = (ctypes.c_double * 16)(*floats(*ARRAYS["gru_initial"])), (ctypes.c_double * 4)(), 0.0
    for given, wanted in zip(inputs, outputs, strict=True):
        library.raptor_step(hidden, (ctypes.c_double * 22)(*given), action)
        worst = max([worst, *(abs(a - b) for a, b in zip(action, wanted, strict=True))])
    print(f"{what}, {len(inputs)} steps: largest difference {worst:.1e}")
    if not worst < 1e-5:
        sys.exit("that is not below 1e-5: the forward pass is wrong")


if sys.argv[1:] and (len(sys.argv) != 3 or sys.argv[1] != "--check"):
    sys.exit(__doc__)
h5 = checkpoint()
if not sys.argv[1:]:
    lines = [f"static const float {name}[] = {{{', '.join(f'{x}f' for x in floats(*place))}}};" for name, place in ARRAYS.items()]
    lines.insert(0, "// foundation-policy 1.0.2, MIT licence, (c) Jonas Eschmann. Made by weights.py; do not edit.")
    (HERE / "raptor_weights.h").write_text("\n".join(lines) + "\n")
    sys.exit()
library = ctypes.CDLL(sys.argv[2])
for n in range(2):
    inputs, outputs = ([floats(at + 4 * width * (2 * step + n), width) for step in range(STEPS)] for at, width in ((INPUT, 22), (OUTPUT, 4)))
    compare(f"rl-tools, sequence {n + 1}", inputs, outputs)
try:
    import foundation_policy, numpy
except ImportError:
    print("the package: not compared, because it is not installed (pip install foundation-policy==1.0.2)")
    sys.exit()
policy, inputs = foundation_policy.Raptor(), [[random.gauss(0, 1) for _ in range(22)] for _ in range(STEPS)]
policy.reset()
compare("the package, random inputs", inputs, [policy.evaluate_step(numpy.array([given], numpy.float32))[0] for given in inputs])
