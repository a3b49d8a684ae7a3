"""What the size of a population costs or brings, method by method, on our problems and on functions that are not ours."""
