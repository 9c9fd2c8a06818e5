//! A channel as the stream that axum sends.

use futures_util::stream::{Stream, poll_fn};
use tokio::sync::mpsc::Receiver;

/// Returns received messages, as a stream that ends with the last sender.
pub fn received<T>(mut channel: Receiver<T>) -> impl Stream<Item = T> {
    poll_fn(move |context| channel.poll_recv(context))
}
