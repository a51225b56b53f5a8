"""Public benchmarks of nonlinearbenchmark.org: official splits, choice of models, errors of the tests.

python -m benchmarks public [--only silverbox|emps|bouc_wen] [--folder DIR] [--out FILE]
python -m benchmarks public --stand-ins

The files are downloaded by the package `nonlinear_benchmarks`, or read from a folder. With --stand-ins,
simulated tests and held-out parts of the training records take the place of the official tests. With
--unverified, files are used that are not the official ones.
"""
