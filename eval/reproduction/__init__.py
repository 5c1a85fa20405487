"""The paper's figures and claims, regenerated from the environment; `eval/paper.py` is the command."""
