//! What two photos say about each other: one rigid scene, a plane, a turn on the spot, or nothing.
