// How functions that depend on files and on user input report failure: by value, with a message for a person.
#pragma once

#include <glog/logging.h>

#include <optional>
#include <string>
#include <utility>

namespace saltus {

// Success, or an error with a message that names what was wrong and where.
class [[nodiscard]] Status {
 public:
  Status() = default;  // success

  static Status Error(std::string message) {
    Status status;
    status.message_ = std::move(message);
    return status;
  }

  bool ok() const { return !message_.has_value(); }

  // Empty on success.
  const std::string& message() const {
    static const std::string empty;
    return message_ ? *message_ : empty;
  }

 private:
  std::optional<std::string> message_;
};

// A value, or the error that prevented it.
template <typename T>
class [[nodiscard]] StatusOr {
 public:
  StatusOr(T value) : value_(std::move(value)) {}  // NOLINT: implicit, so that functions return either

  // Precondition: `error` is an error.
  StatusOr(Status error) : status_(std::move(error)) {  // NOLINT: as above
    CHECK(!status_.ok()) << "a StatusOr without a value needs an error";
  }

  bool ok() const { return value_.has_value(); }
  const Status& status() const { return status_; }

  // Precondition: ok().
  const T& value() const& { return Checked(), *value_; }
  T& value() & { return Checked(), *value_; }
  T&& value() && { return Checked(), std::move(*value_); }
  const T& operator*() const& { return value(); }
  T& operator*() & { return value(); }
  T&& operator*() && { return std::move(*this).value(); }
  const T* operator->() const { return &value(); }
  T* operator->() { return &value(); }

 private:
  void Checked() const { CHECK(ok()) << status_.message(); }

  Status status_;
  std::optional<T> value_;
};

}  // namespace saltus
