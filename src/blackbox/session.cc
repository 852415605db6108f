#include "blackbox/session.h"

#include <glog/logging.h>
#include <poll.h>

#include <algorithm>
#include <deque>
#include <utility>

#include "blackbox/conversation.h"

namespace saltus {
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

bool Session::Ask(std::vector<Request> requests, const StopRequest& stop) {
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
