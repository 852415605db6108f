// The progress of a long computation: a redrawn bar on a terminal, a line now and then elsewhere.
#pragma once

#include <chrono>
#include <cstdint>
#include <cstdio>
#include <functional>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>

namespace saltus {

enum class ProgressMode {
  kAuto,   // a bar if the sink is a terminal, else as kPlain
  kPlain,  // one line every few seconds and one at the end
  kNone,   // nothing
};

// Parses "auto", "plain" or "none"; std::nullopt for other words.
std::optional<ProgressMode> ParseProgressMode(std::string_view word);

// The state of a progress bar at one moment.
struct ProgressState {
  std::string name;
  int64_t done = 0;
  int64_t total = 0;   // 0 if not known
  double elapsed = 0;  // s
  std::string note;
  bool alike = true;     // units of work take about as long as each other, so that the time left can be estimated
  double last_done = 0;  // s, when the last unit was done
  bool ended = false;    // no more units follow
};

// Returns a line of up to `columns` columns, e.g. "sweep [=====>    ] 512/1000  51%  128/s  0:04 left  lcp".
std::string ProgressBar(const ProgressState& state, size_t columns);

// Returns the line without the bar and of any length, for log files.
std::string ProgressLine(const ProgressState& state);

// Reports the progress of one task; the last report is made when the object goes. All members may be called from any
// thread. Only one object should write to a terminal at a time.
class Progress {
 public:
  using Clock = std::function<std::chrono::steady_clock::time_point()>;

  // `sink` is usually stderr and must outlive the object. `total` is the number of units of work, 0 if not known.
  Progress(ProgressMode mode, std::FILE* sink, std::string name, int64_t total,
           Clock clock = std::chrono::steady_clock::now);
  ~Progress();
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;

  // Reports that `units` more units are finished; `note` is what is being computed.
  void Advance(int64_t units = 1, std::string_view note = "");

  // Reports that some units take far longer than others, so that the time left is not estimated.
  void UnitsDiffer();

  // Makes the last report; further calls report nothing.
  void Finish();

 private:
  double Seconds() const;
  void Report(std::string_view note);
  void Draw();

  std::FILE* sink_;
  bool silent_;
  bool bar_;
  Clock clock_;
  std::chrono::steady_clock::time_point start_;
  std::mutex mutex_;  // guards what follows
  ProgressState state_;
  double next_report_;  // s since the start
};

}  // namespace saltus
