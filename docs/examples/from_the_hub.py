"""Run a policy that somebody offers: `python docs/examples/from_the_hub.py FOLDER`, or `--repo-id ORG/NAME`.

Of the folder, `policy.safetensors` is read, numbers and text. Nothing in it is executed.
With --repo-id it is downloaded from the Hugging Face Hub first, which takes the package `huggingface_hub`.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from agents.policy.bundle import POLICY_FILE, load_controller, read_spec
from baselines.tools.command import one_line_errors
from beltarm_env.rollout import rollout
from beltarm_env.task.seeds import fresh_arms

ARM = fresh_arms(0).first  # seed of an arm that nothing is trained or tuned on


def download(repo_id: str) -> Path:
    """Download a policy, and nothing else of its repository.

    Raises:
        ValueError: If `huggingface_hub` is not installed.
        OSError: If there is no such repository, or no network.
    """
    try:
        from huggingface_hub import snapshot_download
    except ImportError:
        raise ValueError(
            "--repo-id needs the package huggingface_hub: pip install huggingface_hub, or give a folder"
        ) from None
    return Path(snapshot_download(repo_id, allow_patterns=POLICY_FILE))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("folder", nargs="?", type=Path, help="folder of a policy")
    source.add_argument("--repo-id", metavar="ORG/NAME", help="repository of a policy on the Hub")
    given = parser.parse_args()
    with one_line_errors("from_the_hub.py"):
        folder = given.folder or download(given.repo_id)
        controller, (spec, _) = load_controller(folder), read_spec(folder)
        run = rollout(controller, 1, seed=ARM, sensors=spec.sensors, randomization="train")
        print(f"{spec.algorithm} on {spec.base}: cost {run.cost[0]:.1f}")


if __name__ == "__main__":
    main()
