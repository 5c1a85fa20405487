"""Equations of the arm: friction, motion, kinematics, integration, linear models; scalar, without sensors or task."""
