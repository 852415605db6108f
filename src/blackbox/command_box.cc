#include "blackbox/command_box.h"

#include <glog/logging.h>
#include <poll.h>

#include <algorithm>
#include <utility>

#include "blackbox/conversation.h"
#include "blackbox/protocol.h"

namespace saltus {
namespace {

constexpr std::size_t kMostSessions = 3;
constexpr std::size_t kMostOutstanding = 16;               // of a copy
constexpr std::size_t kForACopy = 4;                       // questions that make another copy worth its start
constexpr std::size_t kShortLine = 1 << 20, kDigits = 40;  // characters of a line, and of a number

// Returns the scene without the data that each question states again.
Scene WithoutMotion(Scene scene) {
  scene.name = "scene";
  scene.duration = scene.steps = 1;
  for (Body& body : scene.bodies) {
    if (!body.fixed) body.position = body.velocity = Vec2d::Zero();
  }
  std::fill(scene.control.initial.begin(), scene.control.initial.end(), Vec2d::Zero());
  scene.objective = {};
  scene.optimize = Optimize::kNone;
  scene.free.clear();
  return scene;
}

std::size_t MostCharacters(const Scene& scene, const Question& question) {
  const std::size_t steps = question.steps + 1;
  return kShortLine + kDigits * steps * (4 * scene.num_bodies() + scene.control_width());
}

}  // namespace

// The copies of the command that were given one scene.
class CommandBox::Session {
 public:
  Session(const Scene& scene, const CommandOptions& options)
      : scene_(scene), still_(WithoutMotion(scene)), options_(options) {}

  bool IsOf(const Scene& scene) const { return WithoutMotion(scene) == still_; }
  const BlackBoxTraits& traits() const { return traits_; }
  // Waits for the greeting of the first copy.
  std::string Start();
  // Asks all questions. Returns the reason why the command can no longer be used; empty if it can.
  std::string Ask(const std::vector<Question>& questions, const StopRequest& stop, std::vector<Answer>* answers);

 private:
  using Copy = std::unique_ptr<Conversation>;

  void AddCopy();
  void HandOut(const std::vector<Question>& questions, std::size_t* next);
  // Waits until something happens, or a moment has passed, and takes the lines that have arrived.
  std::string Exchange(const Conversation::OnLine& on_line);

  Scene scene_, still_;
  const CommandOptions& options_;
  BlackBoxTraits traits_;
  std::int64_t next_id_ = 1;
  std::vector<std::int64_t> ids_;  // of the questions at hand
  std::vector<Copy> copies_;
};

void CommandBox::Session::AddCopy() {
  copies_.push_back(std::make_unique<Conversation>(options_.command, options_.on_error_line));
  copies_.back()->Send(HelloLine(scene_), {-1, "the greeting", kShortLine});
}

std::string CommandBox::Session::Exchange(const Conversation::OnLine& on_line) {
  std::vector<pollfd> waited;
  for (const Copy& copy : copies_) copy->AddTo(&waited);
  poll(waited.data(), waited.size(), kLook);
  for (const Copy& copy : copies_) {
    copy->Exchange(on_line);
    copy->CheckTime(options_.seconds);
    if (!copy->failure().empty()) return copy->failure();
  }
  return "";
}

std::string CommandBox::Session::Start() {
  AddCopy();
  std::string failure = copies_.front()->failure();
  while (failure.empty() && !copies_.front()->expected().empty()) {
    failure = Exchange([this](const Expected&, const std::string& line) { traits_ = ReadHello(line); });
  }
  return failure;
}

void CommandBox::Session::HandOut(const std::vector<Question>& questions, std::size_t* next) {
  while (*next < questions.size()) {
    const auto least = std::ranges::min_element(
        copies_, [](const Copy& a, const Copy& b) { return a->expected().size() < b->expected().size(); });
    if ((*least)->expected().size() >= kMostOutstanding || (*least)->has_unwritten()) return;
    const Question& question = questions[*next];
    const std::int64_t id = ids_[*next] = next_id_++;
    (*least)->Send(QuestionLine(scene_, question, id, traits_),
                   {static_cast<int>(*next), saltus::Describe(question, id), MostCharacters(scene_, question)});
    (*least)->Write();
    ++*next;
  }
}

std::string CommandBox::Session::Ask(const std::vector<Question>& questions, const StopRequest& stop,
                                     std::vector<Answer>* answers) {
  while (static_cast<int>(copies_.size()) < options_.copies && copies_.size() * kForACopy < questions.size()) AddCopy();
  ids_.assign(questions.size(), 0);
  std::size_t next = 0, answered = 0;
  while (answered < questions.size()) {
    if (stop && stop()) {
      copies_.clear();  // with their answers
      return kStopped;
    }
    HandOut(questions, &next);
    const std::string failure = Exchange([&](const Expected& expected, const std::string& line) {
      const int i = expected.index;
      if (i < 0) {
        traits_ = ReadHello(line);
        return;
      }
      (*answers)[i] = ReadAnswer(line, scene_, questions[i], ids_[i], traits_);
      ++answered;
    });
    if (!failure.empty()) return failure;
  }
  return "";
}

CommandBox::CommandBox(CommandOptions options) : options_(std::move(options)) {
  CHECK_GT(options_.copies, 0);
  CHECK_GT(options_.seconds, 0);
}

CommandBox::~CommandBox() = default;

CommandBox::Session& CommandBox::SessionOf(const Scene& scene) {
  const auto known =
      std::ranges::find_if(sessions_, [&](const std::unique_ptr<Session>& session) { return session->IsOf(scene); });
  if (known != sessions_.end()) {
    std::rotate(known, known + 1, sessions_.end());
    return *sessions_.back();
  }
  if (sessions_.size() == kMostSessions) sessions_.erase(sessions_.begin());
  sessions_.push_back(std::make_unique<Session>(scene, options_));
  const std::string failure = sessions_.back()->Start();
  if (!failure.empty()) broken_ = "'" + options_.command + "': " + failure;
  return *sessions_.back();
}

BlackBoxTraits CommandBox::Describe(const Scene& scene) {
  const std::lock_guard lock(mutex_);
  BlackBoxTraits traits;
  if (broken_.empty()) traits = SessionOf(scene).traits();
  if (!broken_.empty()) traits.error = broken_;
  return traits;
}

std::vector<Answer> CommandBox::Ask(const Scene& scene, const std::vector<Question>& questions,
                                    const StopRequest& stop) {
  const std::lock_guard lock(mutex_);
  std::vector<Answer> answers(questions.size());
  std::string failure = broken_;
  if (failure.empty()) {
    Session& session = SessionOf(scene);
    failure = broken_.empty() ? session.Ask(questions, stop, &answers) : broken_;
    if (!failure.empty() && failure != broken_ && failure != kStopped) {
      failure = broken_ = "'" + options_.command + "': " + failure;
    }
  }
  if (!broken_.empty()) sessions_.clear();
  for (Answer& answer : answers) {
    if (!failure.empty() && answer.final.empty() && answer.error.empty()) answer.error = failure;
  }
  return answers;
}

}  // namespace saltus
