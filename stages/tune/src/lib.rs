//! Random search of the field's hyper-parameters.
