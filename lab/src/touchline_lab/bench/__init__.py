"""The open benchmark: a suite of drives that any program can enter, its inputs written out, its results scored."""
