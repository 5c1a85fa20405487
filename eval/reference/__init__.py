"""Independent solutions of the equations of motion, against which the tests and some studies check the plant."""
