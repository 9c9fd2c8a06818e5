//! Connections of the server: how many there are, and how long each may take to say what it wants.

use std::collections::VecDeque;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::http::StatusCode;
use axum::response::Response;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::{Service as _, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Notify;

/// Longest time for the headers of a request, also of the next one of a connection.
const HEADER_TIME: Duration = Duration::from_secs(10);
/// Most bytes of the headers.
const MOST_HEADER_BYTES: usize = 64 << 10;
/// Most connections: systems allow a process 256 files and more, and the store needs some.
const MOST_CONNECTIONS: usize = 128;
/// Pause after a connection that the system refused.
const REFUSED_PAUSE: Duration = Duration::from_millis(100);

/// A connection.
#[derive(Default)]
struct Connection {
    /// A request was answered with content. Until then the connection makes room for others.
    is_served: AtomicBool,
    /// A newer connection takes its place.
    replaced: Notify,
}

/// Accepts connections without end. It returns if the port is lost.
pub async fn serve(listener: TcpListener, routes: Router) -> io::Result<()> {
    let mut open: VecDeque<Arc<Connection>> = VecDeque::new();
    loop {
        let stream = match listener.accept().await {
            Ok((stream, _)) => stream,
            Err(error) if is_of_listener(&error) => return Err(error),
            Err(_) => {
                tokio::time::sleep(REFUSED_PAUSE).await;
                continue;
            }
        };
        // Each running connection holds the second reference.
        open.retain(|connection| Arc::strong_count(connection) > 1);
        if open.len() >= MOST_CONNECTIONS && !replace_oldest(&mut open) {
            continue;
        }
        let connection = Arc::<Connection>::default();
        open.push_back(Arc::clone(&connection));
        tokio::spawn(answer(connection, stream, routes.clone()));
    }
}

/// Returns true if the port itself is lost, and not one connection.
fn is_of_listener(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::InvalidInput | io::ErrorKind::NotConnected
    )
}

/// Ends the oldest connection that was not served yet. Returns false if all were.
fn replace_oldest(open: &mut VecDeque<Arc<Connection>>) -> bool {
    let is_waiting = |connection: &Arc<Connection>| !connection.is_served.load(Ordering::Relaxed);
    let Some(oldest) = open.iter().position(is_waiting).and_then(|at| open.remove(at)) else {
        return false;
    };
    oldest.replaced.notify_one();
    true
}

/// Answers the requests of a connection.
async fn answer(connection: Arc<Connection>, stream: TcpStream, routes: Router) {
    let routes = TowerToHyperService::new(routes);
    let service = service_fn(|request: hyper::Request<Incoming>| {
        let response = routes.call(request.map(Body::new));
        let connection = &connection;
        async move {
            let response: Response = response.await?;
            let is_refused = [StatusCode::UNAUTHORIZED, StatusCode::FORBIDDEN].contains(&response.status());
            connection.is_served.fetch_or(!is_refused, Ordering::Relaxed);
            Ok::<_, std::convert::Infallible>(response)
        }
    });
    let mut protocol = http1::Builder::new();
    let protocol = protocol
        .timer(TokioTimer::new())
        .header_read_timeout(HEADER_TIME)
        .max_buf_size(MOST_HEADER_BYTES);
    tokio::select! {
        // A client that leaves or breaks the protocol is no fault of the server.
        _ = protocol.serve_connection(TokioIo::new(stream), service) => {}
        () = connection.replaced.notified() => {}
    }
}
