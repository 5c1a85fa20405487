"""The paper's figures and claims, regenerated in the environment; `eval/paper.py` is the command."""
