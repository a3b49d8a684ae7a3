"""The choice of one setting of a method from a sweep, and its value on instances that had no part in the choice."""
