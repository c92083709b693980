#pragma once

#include <atomic>
#include <boost/asio/any_io_executor.hpp>
#include <boost/asio/steady_timer.hpp>
#include <chrono>
#include <functional>
#include <memory>
#include <utility>

namespace soundmap::api {

// Runs something on an executor after a delay, once however often it is called until then: what
// waits to run is bounded however far the executor is behind. Never blocks; copies are the same
// wake. Thread safe; the executor's context outlives it.
class Wake {
 public:
  Wake(const boost::asio::any_io_executor& executor, std::chrono::milliseconds delay,
       std::function<void()> run)
      : state_(std::make_shared<State>(executor, delay, std::move(run))) {}

  void operator()() const {
    if (state_->pending.exchange(true)) return;
    state_->timer.expires_after(state_->delay);
    state_->timer.async_wait([state = state_](boost::system::error_code cancelled) {
      // What happens from here on asks for another run.
      state->pending = false;
      if (!cancelled) state->run();
    });
  }

 private:
  struct State {
    State(const boost::asio::any_io_executor& executor, std::chrono::milliseconds delay_in,
          std::function<void()> run_in)
        : timer(executor), delay(delay_in), run(std::move(run_in)) {}

    boost::asio::steady_timer timer;  // only who has set `pending` uses it
    const std::chrono::milliseconds delay;
    const std::function<void()> run;
    std::atomic<bool> pending = false;
  };

  std::shared_ptr<State> state_;
};

}  // namespace soundmap::api
