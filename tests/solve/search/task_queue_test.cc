// Tasks worked off by several threads: what is drawn and looked at, in which order, and that no thread waits in vain.
#include "solve/search/task_queue.h"

#include <gtest/gtest.h>

#include <atomic>
#include <future>
#include <new>
#include <numeric>
#include <string>

namespace saltus {
namespace {

// Draws up to 200 numbers, each from what has been looked at, and writes down what happens.
std::string Log(int threads) {
  std::string log;
  int drawn = 0, looked = 0, sum = 0;
  TaskQueue<int, int> line;
  line.draw = [&]() -> std::optional<int> {
    if (drawn == 200 || (looked > 50 && looked < 55)) return std::nullopt;  // a while in which there is nothing
    const int task = 31 * drawn++ + sum % 7;
    log += "d" + std::to_string(task) + " ";
    return task;
  };
  line.solve = [](const int& task) {
    volatile int work = 0;
    for (int i = 0; i < task % 13 * 1000; ++i) work = work + i;
    return task * task % 101;
  };
  line.look = [&](const int& task, int found) {
    ++looked;
    sum += found;
    log += "l" + std::to_string(task) + "=" + std::to_string(found) + " ";
  };
  line.RunAll(threads);
  EXPECT_EQ(drawn, 200);
  EXPECT_EQ(looked, 200);
  return log;
}

TEST(TaskQueue, TheNumberOfThreadsChangesNothing) {
  const std::string one = Log(1);
  EXPECT_EQ(Log(2), one);
  EXPECT_EQ(Log(5), one);
}

TEST(TaskQueue, LooksInOrder) {
  std::vector<int> looked;
  TaskQueue<int, int> line;
  int drawn = 0;
  line.draw = [&]() -> std::optional<int> { return drawn < 40 ? std::optional(drawn++) : std::nullopt; };
  line.solve = [](const int& task) { return task; };
  line.look = [&](const int& task, int) { looked.push_back(task); };
  line.RunAll(3);
  std::vector<int> expected(40);
  std::iota(expected.begin(), expected.end(), 0);
  EXPECT_EQ(looked, expected);
}

// A long task that ends only when all others that are under way have: in order, nobody would ever begin these.
TEST(TaskQueue, OthersGoOnBesideALongOne) {
  std::atomic<int> solved{0};
  std::promise<void> enough;
  int drawn = 0;
  TaskQueue<int, int> line;
  line.draw = [&]() -> std::optional<int> { return drawn < 40 ? std::optional(drawn++) : std::nullopt; };
  line.solve = [&](const int& task) {
    if (task == 0) {
      enough.get_future().wait();
    } else if (++solved == static_cast<int>(kMostUnderWay) - 1) {
      enough.set_value();
    }
    return task;
  };
  line.look = [](const int&, int) {};
  line.RunAll(2);
  EXPECT_EQ(solved, 39);
}

TEST(TaskQueue, NothingToDo) {
  TaskQueue<int, int> line;
  line.draw = []() -> std::optional<int> { return std::nullopt; };
  line.solve = [](const int& task) { return task; };
  line.look = [](const int&, int) { ADD_FAILURE(); };
  line.RunAll(1);
  line.RunAll(4);
}

TEST(TaskQueue, WhatATaskThrowsComesOut) {
  for (const int threads : {1, 3}) {
    TaskQueue<int, int> line;
    int drawn = 0, looked = 0;
    line.draw = [&]() -> std::optional<int> { return drawn < 40 ? std::optional(drawn++) : std::nullopt; };
    line.solve = [](const int& task) { return task == 11 ? throw std::bad_alloc() : task; };
    line.look = [&](const int&, int) { ++looked; };
    EXPECT_THROW(line.RunAll(threads), std::bad_alloc);
    EXPECT_EQ(looked, 11);
  }
}

}  // namespace
}  // namespace saltus
