"""The full arm in MuJoCo: model, physics engine and pictures. Needs the extra `mujoco`."""
