"""`bench discover` and `bench design`: searches, a folder a set, their store, and the page of a verdict."""
