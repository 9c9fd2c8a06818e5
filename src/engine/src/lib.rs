//! Plans and runs the graph of stages; knows no Mars, no image, no GPU.
