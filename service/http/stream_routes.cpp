// What goes on until the client leaves: server-sent events and motion JPEG.
#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <chrono>
#include <functional>
#include <thread>

#include "service/http/internal/context.h"

namespace penumbra::service {

using httplib::Request;
using httplib::Response;
using Clock = std::chrono::steady_clock;

namespace {

constexpr const char* kBoundary = "penumbra-frame";

// Its place among the streams; answers itself where there is none.
bool take_place(HttpContext& context, Response& r) {
  if (++context.streams <= HttpContext::kMaxStreams) return true;
  --context.streams;
  reply(
      r,
      {{"error", fmt::format("{} streams are open: no more are served", HttpContext::kMaxStreams)}},
      503);
  return false;
}

// A rate in hertz that a request asks for.
Result<double> rate_of(const Request& q, double usual, double most) {
  constexpr double kLeast = .1;
  if (!q.has_param("rate_hz")) return usual;
  const std::string text = q.get_param_value("rate_hz");
  double rate = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), rate);
  const bool whole = error == std::errc() && end == text.data() + text.size();
  if (!whole || !(rate >= kLeast && rate <= most))
    return fail(ErrorCode::kInvalid, "rate_hz", fmt::format("is not within {}..{}", kLeast, most));
  return rate;
}

// False when the service stops first, or the client has left.
bool wait_until(Clock::time_point due, const HttpContext& context,
                const std::function<bool()>& is_there) {
  constexpr std::chrono::milliseconds kSlice(50), kLook(2000);
  Clock::time_point look = Clock::now() + kLook;
  while (!context.stopping && Clock::now() < due) {
    std::this_thread::sleep_until(std::min(due, Clock::now() + kSlice));
    if (Clock::now() < look) continue;
    look += kLook;
    if (!is_there()) return false;
  }
  return !context.stopping;
}

using Provider = httplib::ContentProviderWithoutLength;

// In chunks; to a client of HTTP/1.0, which knows none, until the connection ends.
void reply_with_stream(HttpContext& context, const Request& q, Response& r, const std::string& type,
                       Provider provider) {
  const auto leave = [&context](bool) { --context.streams; };
  r.set_header("Cache-Control", "no-store");
  if (q.version != "HTTP/1.0")
    return r.set_chunked_content_provider(type, std::move(provider), leave);
  r.set_header("Connection", "close");
  r.set_content_provider(type, std::move(provider), leave);
}

void stream_events(HttpContext& context, const Request& q, Response& r) {
  const auto rate = rate_of(q, 4, 30);
  if (!rate) return refuse(r, rate.error());
  if (!take_place(context, r)) return;
  const auto period = std::chrono::duration_cast<Clock::duration>(Seconds(1 / *rate));
  reply_with_stream(
      context, q, r, "text/event-stream",
      [&context, period, due = Clock::now()](std::size_t, httplib::DataSink& sink) mutable {
        // A comment, which only shows that the client is there.
        if (!wait_until(due, context, [&] { return sink.write(":\n\n", 3); })) return false;
        due = std::max(due + period, Clock::now());
        const std::string text =
            "event: state\ndata: " +
            state_json(context).dump(-1, ' ', false, nlohmann::json::error_handler_t::replace) +
            "\n\n";
        return sink.write(text.data(), text.size());
      });
}

// The newest frame each time; a client that takes them slowly gets fewer.
void stream_frames(HttpContext& context, const Request& q, Response& r) {
  const auto rate = rate_of(q, 60, 240);
  if (!rate) return refuse(r, rate.error());
  if (!take_place(context, r)) return;
  const auto period = std::chrono::duration_cast<Clock::duration>(Seconds(1 / *rate));
  reply_with_stream(
      context, q, r, fmt::format("multipart/x-mixed-replace; boundary={}", kBoundary),
      [&context, period, shown = std::uint64_t{0}, due = Clock::now()](
          std::size_t, httplib::DataSink& sink) mutable {
        if (!wait_until(due, context, [&] { return sink.is_writable(); })) return false;
        due = std::max(due + period, Clock::now());
        while (!context.sources.state.wait_beyond(shown, std::chrono::milliseconds(100)))
          if (context.stopping || !sink.is_writable()) return false;
        const auto s = context.sources.state.snapshot();
        shown = s.frames;
        if (!s.frame) return true;
        const auto jpeg = context.frame_files.jpeg(s.frame, s.now);
        if (!jpeg) return false;
        const std::string head = fmt::format(
            "--{}\r\nContent-Type: image/jpeg\r\nContent-Length: {}\r\n"
            "X-Timestamp: {:.6f}\r\n\r\n",
            kBoundary, jpeg->bytes->size(), static_cast<double>(jpeg->time.value) * 1e-9);
        return sink.write(head.data(), head.size()) &&
               sink.write(jpeg->bytes->data(), jpeg->bytes->size()) && sink.write("\r\n", 2);
      });
}

}  // namespace

void add_stream_routes(httplib::Server& server, HttpContext& context) {
  server.Get("/v1/events", [&](const Request& q, Response& r) { stream_events(context, q, r); });
  server.Get("/v1/frame.mjpeg",
             [&](const Request& q, Response& r) { stream_frames(context, q, r); });
}

}  // namespace penumbra::service
