"""Studies: questions about the arm and its controllers, each measured by one module and told on one page.

A study X is the module `eval/studies/x.py`, the command `eval/study.py x`, and the folder `docs/results/x`.
`eval/studies/_frame.py` says what such a module has.
"""
