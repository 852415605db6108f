#include "blackbox/conversation.h"

#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <utility>

#include "base/file.h"
#include "base/number_text.h"
#include "blackbox/protocol.h"

namespace saltus {
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

void Conversation::Exchange(const OnLine& on_line) {
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

void Conversation::Read(const OnLine& on_line) {
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

void Conversation::TakeLines(const OnLine& on_line) {
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

}  // namespace saltus
