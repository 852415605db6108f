#include "blackbox/session.h"

#include <fcntl.h>
#include <glog/logging.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/types.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <ctime>
#include <deque>
#include <utility>

#include "base/file.h"
#include "base/number_text.h"

namespace saltus {

// ---- A command and the exchange of lines with it

// A command that runs beside this program, with its three standard streams as pipes. It runs in a process group of its
// own, so that Ctrl-C at the terminal does not reach it. A keeper process, which waits for nothing else, kills the
// whole group as soon as this object goes, or this program ends, however that happens.
class ChildProcess {
 public:
  // Starts `command` by /bin/sh. If that fails, `error` is the reason and no descriptor is valid.
  ChildProcess(const std::string& command, std::string* error);
  ~ChildProcess();
  ChildProcess(const ChildProcess&) = delete;
  ChildProcess& operator=(const ChildProcess&) = delete;

  // The descriptors of its streams, which do not block; -1 if closed.
  int input() const { return input_; }    // to be written to
  int output() const { return output_; }  // to be read from, as is
  int errors() const { return errors_; }

  // Closes its input, gives it a moment to end by itself, kills it if it does not, and waits for it. Returns how it
  // ended, in words: "ended with exit code 3", "was killed by signal 9".
  std::string End();

 private:
  pid_t keeper_ = -1;
  int input_ = -1, output_ = -1, errors_ = -1;
  int lifeline_ = -1;  // when it is closed, the keeper ends the command
};

inline constexpr int kLook = 20;  // ms, how often time and interrupts are looked at while an answer is awaited

// An expected answer: one line in return for one that was sent.
struct Expected {
  int index = -1;        // of the question; -1: the greeting
  std::string what;      // for messages: "request 7 (simulate of 480 steps)"
  std::size_t most = 0;  // characters of the answer
};

// No member blocks. After a failure nothing more is sent or read.
class Conversation {
 public:
  using Clock = std::chrono::steady_clock;
  using LineCallback = std::function<void(const Expected& expected, const std::string& line)>;

  Conversation(const std::string& command, std::function<void(const std::string&)> on_error_line);

  void Send(std::string line, Expected expected);
  // Writes as much as the pipe takes.
  void Write();
  // Writes and reads as much as the pipes allow, and calls on_line for each line that has arrived. A ProtocolError
  // thrown by on_line is a failure.
  void Exchange(const LineCallback& on_line);
  // Fails if nothing has arrived for this long.
  void CheckTime(double seconds);

  const std::string& failure() const { return failure_; }
  const std::deque<Expected>& expected() const { return expected_; }
  bool has_unwritten() const { return written_ < unwritten_.size(); }
  // Adds the descriptors to wait for.
  void AddTo(std::vector<pollfd>* waited) const;

 private:
  void Fail(const std::string& why);
  void Read(const LineCallback& on_line);
  void TakeLines(const LineCallback& on_line);
  void ReadErrors();

  std::string failure_;
  ChildProcess process_;
  std::function<void(const std::string&)> on_error_line_;
  std::string unwritten_, unread_, unread_errors_;
  std::size_t written_ = 0;
  bool errors_open_ = true;
  std::deque<Expected> expected_;
  Clock::time_point last_ = Clock::now();  // when something was asked of an idle copy, or came back
};

namespace {

constexpr int kGrace = 50;                 // looks whether the command has ended by itself, before it is killed
constexpr long kBetweenLooks = 2'000'000;  // ns between two of them
constexpr int kSignalled = 128;  // exit codes of the keeper above this are signals, as of a shell; this: it ran
constexpr int kNothing = 127;    // exit code of a shell that finds no such command
enum End : int { kRead = 0, kWrite = 1 };  // of a pipe
using Pipe = std::array<int, 2>;

bool Open(Pipe* pipe) { return pipe2(pipe->data(), O_CLOEXEC) == 0; }

void Close(int* descriptor) {
  if (*descriptor >= 0) close(*descriptor);
  *descriptor = -1;
}

// The functions below run between fork and exec, or in the keeper. Other threads may have held any lock at the fork, so
// they use system calls only.

void Default(int signal_number) {
  struct sigaction action = {};
  action.sa_handler = SIG_DFL;
  sigaction(signal_number, &action, nullptr);
}

[[noreturn]] void Execute(const char* command, const Pipe& in, const Pipe& out, const Pipe& errors) {
  setpgid(0, 0);
  for (const int signal_number : {SIGINT, SIGTERM, SIGPIPE, SIGXFSZ}) Default(signal_number);
  dup2(in[kRead], STDIN_FILENO);
  dup2(out[kWrite], STDOUT_FILENO);
  dup2(errors[kWrite], STDERR_FILENO);
  execl("/bin/sh", "sh", "-c", command, static_cast<char*>(nullptr));
  _exit(kNothing);
}

// Waits a moment at most; returns 0 if the child still runs.
pid_t WaitFor(pid_t child, int* status) {
  pid_t ended = 0;
  for (int i = 0; i < kGrace && (ended = waitpid(child, status, WNOHANG)) == 0; ++i) {
    const timespec look{0, kBetweenLooks};
    nanosleep(&look, nullptr);
  }
  return ended;
}

[[noreturn]] void Keep(pid_t child, int lifeline) {
  dup2(lifeline, STDIN_FILENO);
  close_range(STDIN_FILENO + 1, ~0U, 0);
  char unused;
  while (read(STDIN_FILENO, &unused, 1) < 0 && errno == EINTR) {
  }
  int status = 0;
  const pid_t ended = WaitFor(child, &status);
  kill(-child, SIGKILL);  // and what it has started
  while (WaitFor(-1, nullptr) > 0) {
  }
  if (ended == 0) _exit(kSignalled);  // what it would have done, nobody knows
  _exit(WIFSIGNALED(status) ? kSignalled + WTERMSIG(status) : WEXITSTATUS(status));
}

[[noreturn]] void StartAndKeep(const char* command, const Pipe& in, const Pipe& out, const Pipe& errors,
                               const Pipe& lifeline) {
  setpgid(0, 0);
  prctl(PR_SET_CHILD_SUBREAPER, 1);  // to wait for what the command has started, too
  const pid_t child = fork();
  if (child < 0) _exit(kNothing);
  if (child == 0) Execute(command, in, out, errors);
  setpgid(child, child);  // whoever is first
  Keep(child, lifeline[kRead]);
}

}  // namespace

ChildProcess::ChildProcess(const std::string& command, std::string* error) {
  Pipe in = {-1, -1}, out = {-1, -1}, errors = {-1, -1}, lifeline = {-1, -1};
  const bool opened = Open(&in) && Open(&out) && Open(&errors) && Open(&lifeline);
  keeper_ = opened ? fork() : -1;
  if (keeper_ == 0) StartAndKeep(command.c_str(), in, out, errors, lifeline);
  if (keeper_ < 0) *error = std::strerror(errno);
  for (int* unused : {&in[kRead], &out[kWrite], &errors[kWrite], &lifeline[kRead]}) Close(unused);
  if (keeper_ < 0) {
    for (int* unused : {&in[kWrite], &out[kRead], &errors[kRead], &lifeline[kWrite]}) Close(unused);
    return;
  }
  input_ = in[kWrite];
  output_ = out[kRead];
  errors_ = errors[kRead];
  lifeline_ = lifeline[kWrite];
  for (const int descriptor : {input_, output_, errors_}) fcntl(descriptor, F_SETFL, O_NONBLOCK);
}

ChildProcess::~ChildProcess() { End(); }

std::string ChildProcess::End() {
  for (int* descriptor : {&input_, &output_, &errors_, &lifeline_}) Close(descriptor);
  if (keeper_ < 0) return "was not started";
  int status = 0;
  while (waitpid(keeper_, &status, 0) < 0 && errno == EINTR) {
  }
  keeper_ = -1;
  const int code = WIFEXITED(status) ? WEXITSTATUS(status) : kSignalled;
  if (code == kSignalled) return "closed its standard output";
  if (code > kSignalled) return "was killed by signal " + std::to_string(code - kSignalled);
  return "ended with exit code " + std::to_string(code);
}

namespace {

constexpr std::size_t kBlock = 1 << 16;

bool WouldBlock() { return errno == EAGAIN || errno == EINTR; }

}  // namespace

Conversation::Conversation(const std::string& command, std::function<void(const std::string&)> on_error_line)
    : process_(command, &failure_), on_error_line_(std::move(on_error_line)) {
  if (!failure_.empty()) failure_ = "cannot be started: " + failure_;
}

void Conversation::Send(std::string line, Expected expected) {
  if (expected_.empty()) last_ = Clock::now();
  unwritten_.erase(0, std::exchange(written_, 0));
  unwritten_ += line + "\n";
  expected_.push_back(std::move(expected));
}

void Conversation::Fail(const std::string& why) {
  ReadErrors();
  if (on_error_line_ && !unread_errors_.empty()) on_error_line_(std::exchange(unread_errors_, ""));
  failure_ = (expected_.empty() ? "" : expected_.front().what + ": ") + why;
  process_.End();
}

void Conversation::Exchange(const LineCallback& on_line) {
  if (failure_.empty()) Write();
  if (failure_.empty()) ReadErrors();
  if (failure_.empty()) Read(on_line);
}

void Conversation::CheckTime(double seconds) {
  if (!failure_.empty() || expected_.empty()) return;
  if (std::chrono::duration<double>(Clock::now() - last_).count() < seconds) return;
  Fail("silent for " + ToText(seconds, 6) + " s" + (unread_.empty() ? "" : " after " + Excerpt(unread_)) +
       ", expected a line in answer");
}

void Conversation::Write() {
  while (has_unwritten()) {
    const ssize_t count = WriteQuietly(process_.input(), &unwritten_[written_], unwritten_.size() - written_);
    if (count < 0) return;  // if it has ended, that is seen in reading
    written_ += count;
  }
}

void Conversation::ReadErrors() {
  std::array<char, 4096> block;
  ssize_t count = 0;
  while ((count = read(process_.errors(), block.data(), block.size())) > 0) {
    unread_errors_.append(block.data(), count);
    for (std::size_t end; (end = unread_errors_.find('\n')) != std::string::npos;) {
      if (on_error_line_) on_error_line_(unread_errors_.substr(0, end));
      unread_errors_.erase(0, end + 1);
    }
  }
  if (count == 0) errors_open_ = false;
}

void Conversation::AddTo(std::vector<pollfd>* waited) const {
  if (!failure_.empty()) return;
  waited->push_back({process_.output(), POLLIN, 0});
  if (errors_open_) waited->push_back({process_.errors(), POLLIN, 0});
  if (has_unwritten()) waited->push_back({process_.input(), POLLOUT, 0});
}

void Conversation::Read(const LineCallback& on_line) {
  std::array<char, kBlock> block;
  ssize_t count = 0;
  while (failure_.empty() && (count = read(process_.output(), block.data(), block.size())) > 0) {
    unread_.append(block.data(), count);
    TakeLines(on_line);
  }
  if (!failure_.empty() || (count < 0 && WouldBlock())) return;
  if (count < 0) return Fail(std::string("cannot be read: ") + std::strerror(errno));
  const std::string cut = unread_.empty() ? "" : " in the middle of the line " + Excerpt(unread_);
  ReadErrors();
  const std::string end = process_.End();
  Fail(end + cut + ", expected an answer");
}

void Conversation::TakeLines(const LineCallback& on_line) {
  std::size_t begin = 0;
  for (std::size_t end; failure_.empty() && (end = unread_.find('\n', begin)) != std::string::npos; begin = end + 1) {
    const std::string line = unread_.substr(begin, end - begin);
    if (expected_.empty()) return Fail("found " + Excerpt(line) + ", which nothing was asked for");
    try {
      on_line(expected_.front(), line);
    } catch (const ProtocolError& error) {
      return Fail(error.what());
    }
    expected_.pop_front();
    last_ = Clock::now();
  }
  unread_.erase(0, begin);
  const std::size_t most = expected_.empty() ? kBlock : expected_.front().most;
  if (unread_.size() > most) {
    Fail("found a line of more than " + std::to_string(most) + " characters that begins with " + Excerpt(unread_) +
         ", expected an answer");
  }
}

// ---- Several copies of a command

namespace {

constexpr std::size_t kMostOutstanding = 16;   // of a copy
constexpr std::size_t kForACopy = 4;           // requests that make another copy worth its start
constexpr std::size_t kMostOfHello = 1 << 20;  // characters

}  // namespace

Session::Session(ProtocolJson hello, const CommandOptions& options) : hello_(hello.dump()), options_(options) {
  CHECK_GT(options_.copies, 0);
  CHECK_GT(options_.seconds, 0);
  AddCopy();
  while (broken_.empty() && !copies_.front()->expected().empty()) Exchange(nullptr);
}

Session::~Session() = default;

void Session::AddCopy() {
  copies_.push_back(std::make_unique<Conversation>(options_.command, options_.on_error_line));
  copies_.back()->Send(hello_, {-1, "the greeting", kMostOfHello});
}

void Session::Exchange(const std::function<void(int index, const std::string& line)>& on_line) {
  std::vector<pollfd> waited;
  for (const auto& copy : copies_) copy->AddTo(&waited);
  poll(waited.data(), waited.size(), kLook);
  for (const auto& copy : copies_) {
    copy->Exchange([&](const Expected& expected, const std::string& line) {
      if (expected.index < 0) {
        traits_ = ReadHello(line);
      } else {
        on_line(expected.index, line);
      }
    });
    copy->CheckTime(options_.seconds);
    if (copy->failure().empty()) continue;
    broken_ = "'" + options_.command + "': " + copy->failure();
    copies_.clear();
    return;
  }
}

bool Session::Evaluate(std::vector<Request> requests, const StopRequest& stop) {
  while (static_cast<int>(copies_.size()) < options_.copies && copies_.size() * kForACopy < requests.size()) AddCopy();
  std::deque<int> waiting(requests.size());
  for (int i = 0; i < static_cast<int>(requests.size()); ++i) waiting[i] = i;
  std::vector<std::int64_t> ids(requests.size());
  std::size_t done = 0;
  while (broken_.empty() && done < requests.size()) {
    if (stop && stop()) {
      copies_.clear();  // with their answers
      return false;
    }
    while (!waiting.empty()) {
      Conversation& least = **std::ranges::min_element(
          copies_, [](const auto& a, const auto& b) { return a->expected().size() < b->expected().size(); });
      if (least.expected().size() >= kMostOutstanding || least.has_unwritten()) break;
      const int i = waiting.front();
      waiting.pop_front();
      ids[i] = next_id_++;
      ProtocolJson line = {{"id", ids[i]}};
      line.update(requests[i].asked);
      least.Send(line.dump(),
                 {i, "request " + std::to_string(ids[i]) + " (" + requests[i].what + ")", requests[i].most});
      least.Write();
    }
    Exchange([&](int i, const std::string& line) {
      if (requests[i].take(ReadReply(line, ids[i]), &requests[i].asked)) {
        waiting.push_back(i);
      } else {
        ++done;
      }
    });
  }
  return broken_.empty();
}

}  // namespace saltus
