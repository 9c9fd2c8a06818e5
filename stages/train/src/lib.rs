//! A scene and parameters to a trained field; evaluate and render.
