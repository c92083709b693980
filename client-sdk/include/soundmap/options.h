#pragma once

#include <chrono>
#include <string>

namespace soundmap {

// Full-jitter back-off: before attempt n + 1 the client waits a random time between 0 and
// min(max_backoff, initial_backoff * 2^(n-1)).
struct RetryOptions {
  int max_attempts = 5;  // of a call, the first one included
  std::chrono::milliseconds initial_backoff{200};
  std::chrono::milliseconds max_backoff{5000};
};

struct ClientOptions {
  std::string server = "127.0.0.1:7443";  // HOST:PORT
  std::string token;       // bearer token; needs TLS unless the server is on loopback
  std::string tls_ca_pem;  // certificates to trust (PEM text); empty: plain text, no TLS
  std::chrono::milliseconds call_timeout{30'000};     // of one attempt of a short call
  std::chrono::milliseconds stream_timeout{600'000};  // of one import, export, path or voxel query
  RetryOptions retry;
  // A watch gives up after this many connections in a row that told nothing.
  int max_silent_reconnects = 1000;
};

}  // namespace soundmap
