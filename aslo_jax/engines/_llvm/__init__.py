"""A step as the text of LLVM's intermediate representation."""
