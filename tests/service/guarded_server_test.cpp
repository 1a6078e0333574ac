// Clients that a browser is not: hostile, endless or slow.
#include "service/http/internal/guarded_server.h"

#include <gtest/gtest.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <filesystem>
#include <iterator>
#include <latch>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "service/http/internal/workers.h"

namespace penumbra::service {
namespace {

/// Served by the library's server, or by ours, until it goes out of scope.
template <class Server>
struct ListeningServer {
  Server server;
  int changes = 0;
  int port = 0;
  std::jthread thread;

  explicit ListeningServer(std::size_t workers = 4) {
    server.new_task_queue = [=] { return new Workers(workers); };
    server.set_keep_alive_timeout(1);
    server.set_payload_max_length(1 << 16);
    server.set_pre_routing_handler([](const httplib::Request& q, httplib::Response& r) {
      using Handled = httplib::Server::HandlerResponse;
      if (q.get_header_value("Host") != "evil.example") return Handled::Unhandled;
      r.status = 403;
      if (q.has_param("closes")) r.set_header("Connection", "close");
      return Handled::Handled;
    });
    server.Get("/", [](const httplib::Request&, httplib::Response& r) { r.status = 200; });
    server.Patch("/", [this](const httplib::Request&, httplib::Response&) { ++changes; });
    server.Post("/", [](const httplib::Request&, httplib::Response&) {});
    port = server.bind_to_any_port("127.0.0.1");
    if constexpr (std::is_same_v<Server, GuardedServer>) server.widen_queue();
    thread = std::jthread([this] { server.listen_after_bind(); });
    while (!server.is_running()) std::this_thread::yield();
  }
  ~ListeningServer() {
    if constexpr (std::is_same_v<Server, GuardedServer>) server.stop_waiting();
    server.stop();
  }
};

class RawConnection {
 public:
  explicit RawConnection(int port) : socket_(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    sockaddr_in to{};
    to.sin_family = AF_INET;
    to.sin_port = htons(static_cast<std::uint16_t>(port));
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    EXPECT_EQ(::connect(socket_, reinterpret_cast<const sockaddr*>(&to), sizeof to), 0);
  }
  ~RawConnection() { ::close(socket_); }
  RawConnection(const RawConnection&) = delete;
  RawConnection& operator=(const RawConnection&) = delete;
  bool send(const std::string& text) const {
    return ::send(socket_, text.data(), text.size(), MSG_NOSIGNAL) ==
           static_cast<ssize_t>(text.size());
  }
  /// Nothing more is sent; the answer is waited for.
  void end_sending() const { ::shutdown(socket_, SHUT_WR); }
  /// All that comes until the server closes.
  std::string rest() const {
    std::string out;
    std::array<char, 4096> part{};
    for (ssize_t n = 0; (n = ::recv(socket_, part.data(), part.size(), 0)) > 0;)
      out.append(part.data(), static_cast<std::size_t>(n));
    return out;
  }

 private:
  int socket_;
};

std::size_t answers_in(const std::string& text) {
  std::size_t out = 0;
  for (auto at = text.find("HTTP/1.1 "); at != std::string::npos;
       at = text.find("HTTP/1.1 ", at + 1))
    ++out;
  return out;
}

const std::string kInner =
    "PATCH / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 0\r\nConnection: close\r\n\r\n";

// The library reads ahead this far, and throws that away: what an attacker sends begins behind.
constexpr std::size_t kReadAhead = 4096;

// By a request within the body of another one.
template <class Server>
int changes_within(const std::string& head, std::size_t padded_to) {
  ListeningServer<Server> running;
  const RawConnection client(running.port);
  const std::string rest = "\r\n\r\n", pad = "X-Pad: ";
  std::string request = head;
  if (padded_to > head.size() + pad.size() + rest.size())
    request += pad + std::string(padded_to - head.size() - pad.size() - rest.size(), 'x') + rest;
  else
    request += "\r\n";
  client.send(request + kInner);
  (void)client.rest();
  return running.changes;
}

// The library answers what it refuses, leaves its body unread, and takes that for the next request:
// any page could then change what it likes.
TEST(GuardedServer, ABodyThatNobodyReadIsNoRequest) {
  const std::string length = "Content-Length: " + std::to_string(kInner.size()) + "\r\n",
                    local = " / HTTP/1.1\r\nHost: localhost\r\n",
                    foreign = "POST / HTTP/1.1\r\nHost: evil.example\r\n" + length;
  EXPECT_EQ(changes_within<httplib::Server>(foreign, kReadAhead), 1) << "what this guards against";
  for (const std::string& head :
       {foreign, "GET" + local + length, "OPTIONS" + local + length,
        "POST" + local + "Content-Type: multipart/form-data\r\n" + length,
        "POST" + local + "Transfer-Encoding: chunked\r\n", std::string("nonsense\r\n")})
    for (const std::size_t size : {std::size_t{0}, kReadAhead})
      EXPECT_EQ(changes_within<GuardedServer>(head, size), 0) << size << ": " << head;
}

std::string answer_to(const std::string& request, bool ends) {
  ListeningServer<GuardedServer> running;
  const RawConnection client(running.port);
  client.send(request);
  if (ends) client.end_sending();
  return client.rest();
}

// Two programs in a row may take such a head for different requests.
TEST(GuardedServer, AHeadThatMayBeReadTwoWaysIsRefused) {
  using namespace std::string_literals;
  const std::string first = "GET / HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n";
  EXPECT_NE(answer_to(first + "\r\n", false).find(" 200 "), std::string::npos);
  for (const std::string& line :
       {"Content-Length: 2\r\nContent-Length: 2\r\n"s, "Content-Length: 2x\r\n"s,
        "Content-Length: -1\r\n"s, "Content-Length: 99999999999999999999\r\n"s,
        "no colon here\r\n"s, "X-A: b\r\n more of it\r\n"s, "X-A: b\0c\r\n"s}) {
    const std::string answer = answer_to(first + line + "\r\n", false);
    EXPECT_NE(answer.find(" 400 "), std::string::npos) << line << answer;
    EXPECT_NE(answer.find("{\"error\":"), std::string::npos) << line << answer;
  }
}

// As `nc -N` does: it has asked, and reads on.
TEST(GuardedServer, WhoHasSentAllIsAnswered) {
  EXPECT_NE(answer_to("GET / HTTP/1.1\r\nHost: localhost\r\n\r\n", true).find(" 200 "),
            std::string::npos);
}

TEST(GuardedServer, RequestsInOnePacketAreAllAnswered) {
  ListeningServer<GuardedServer> running;
  const RawConnection client(running.port);
  const std::string get = "GET / HTTP/1.1\r\nHost: localhost\r\n\r\n";
  client.send(get + get + kInner);
  EXPECT_EQ(answers_in(client.rest()), 3u);
  EXPECT_EQ(running.changes, 1);
}

TEST(GuardedServer, NothingFollowsAnAnswerThatCloses) {
  const auto answers_to = [](const std::string& path) {
    ListeningServer<GuardedServer> running;
    const RawConnection client(running.port);
    client.send("GET " + path + " HTTP/1.1\r\nHost: evil.example\r\n\r\n" + kInner);
    return answers_in(client.rest());
  };
  EXPECT_EQ(answers_to("/"), 2u);
  EXPECT_EQ(answers_to("/?closes=1"), 1u);
}

TEST(GuardedServer, ABodyThatIsTooLargeIsNotAskedFor) {
  const auto begun = std::chrono::steady_clock::now();
  const std::string answer = answer_to(
      "POST / HTTP/1.1\r\nHost: localhost\r\nExpect: 100-continue\r\n"
      "Content-Length: 1000000000\r\n\r\n",
      false);
  EXPECT_NE(answer.find(" 413 "), std::string::npos) << answer;
  EXPECT_EQ(answers_in(answer), 1u) << answer;
  // A client is otherwise waited for during five seconds.
  EXPECT_LT(std::chrono::steady_clock::now() - begun, std::chrono::seconds(4));
}

std::ptrdiff_t threads_now() {
  return std::distance(std::filesystem::directory_iterator("/proc/self/task"), {});
}

TEST(Workers, EndWhenTheyHaveWaitedForLong) {
  constexpr int kTasks = 8;
  const std::ptrdiff_t before = threads_now();
  Workers workers(kTasks, std::chrono::milliseconds(50));
  for (int round = 0; round < 2; ++round) {
    std::latch all_run(kTasks), ends(1);
    for (int i = 0; i < kTasks; ++i)
      workers.enqueue([&] {
        all_run.count_down();
        ends.wait();
      });
    all_run.wait();
    EXPECT_EQ(threads_now(), before + kTasks);
    ends.count_down();
    for (int i = 0; i < 200 && threads_now() > before; ++i)
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
    EXPECT_EQ(threads_now(), before);
  }
  workers.shutdown();
}

TEST(GuardedServer, AHeadThatNeverEndsIsNotReadIntoMemory) {
  ListeningServer<GuardedServer> running;
  const RawConnection client(running.port);
  client.send("GET / HTTP/1.1\r\n");
  const std::string line = "X-Header: " + std::string(1000, 'x') + "\r\n";
  std::size_t sent = 0;
  while (sent < (64 << 20) && client.send(line)) sent += line.size();
  // What is sent on while the connection closes is read, too, and thrown away.
  EXPECT_LT(sent, std::size_t{16} << 20);
}

// Half a request each, a byte more now and then: all workers wait for them, but not for long.
TEST(GuardedServer, SlowClientsHoldNobodyUp) {
  ListeningServer<GuardedServer> running(GuardedServer::kMaxClients);
  std::vector<std::unique_ptr<RawConnection>> slow;
  for (std::size_t i = 0; i < GuardedServer::kMaxClients + 20; ++i) {
    slow.push_back(std::make_unique<RawConnection>(running.port));
    slow.back()->send("GET / HT");
  }
  std::atomic<bool> ends = false;
  const std::jthread drip([&] {
    while (!ends) {
      for (const auto& c : slow) (void)c->send("x");
      std::this_thread::sleep_for(std::chrono::milliseconds(100));
    }
  });
  httplib::Client client("127.0.0.1", running.port);
  client.set_read_timeout(60);
  const auto answer = client.Get("/");
  ends = true;
  ASSERT_TRUE(answer);
  EXPECT_EQ(answer->status, 200);
}

// It would not stop, as long as the client sends a byte in time.
TEST(GuardedServer, StopsBesideAClientThatDrips) {
  std::atomic<bool> hung_up = false;
  std::jthread drip;
  const auto begun = std::chrono::steady_clock::now();
  {
    ListeningServer<GuardedServer> running;
    drip = std::jthread([&, client = std::make_shared<RawConnection>(running.port)] {
      for (int i = 0; i < 600 && client->send("x"); ++i)
        std::this_thread::sleep_for(std::chrono::milliseconds(100));
      hung_up = true;
    });
    std::this_thread::sleep_for(std::chrono::milliseconds(300));
  }
  drip.join();
  EXPECT_TRUE(hung_up);
  // The client goes on for a minute, and is hung up on long before.
  EXPECT_LT(std::chrono::steady_clock::now() - begun, std::chrono::seconds(30));
}

}  // namespace
}  // namespace penumbra::service
