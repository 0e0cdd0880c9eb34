"""How mechanisms move: trees with loops, forward and inverse kinematics, couplings."""
