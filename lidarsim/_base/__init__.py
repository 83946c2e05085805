"""The ground floor: checks of arguments, files and pickles that every room uses."""
