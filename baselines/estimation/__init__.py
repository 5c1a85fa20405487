"""State observer and identification of the arm, from encoder and torque."""
