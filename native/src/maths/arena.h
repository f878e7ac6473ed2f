// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Work memory: arrays that are taken in turn and given back together; lists with a capacity.

#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

namespace st {

/// Where lines of the cache begin.
constexpr size_t ALIGNMENT = 64;

/// A list with a capacity: what does not fit is counted and left out.
template <class T>
struct List {
    T *item = nullptr;
    int count = 0, capacity = 0, left_out = 0;

    T &operator[](int i) { return item[i]; }
    const T &operator[](int i) const { return item[i]; }
    T *begin() { return item; }
    T *end() { return item + count; }
    const T *begin() const { return item; }
    const T *end() const { return item + count; }

    void clear() { count = left_out = 0; }

    /// Append an element; false where the list is full.
    bool add(const T &one) {
        if (count == capacity) {
            ++left_out;
            return false;
        }
        item[count++] = one;
        return true;
    }

    /// Append those of another list.
    void add_all(const List &other) {
        for (const T &one : other) {
            add(one);
        }
        left_out += other.left_out;
    }
};

/// A block of memory of the caller. Arrays are not cleared.
///
///     const Arena::Scope scope(arena);             gives back what is taken from here on
///     float *line = arena.take<float>(width);
class Arena {
public:
    Arena() = default;

    Arena(void *memory, size_t bytes)
        : begin_(static_cast<std::byte *>(memory)), bytes_(bytes / ALIGNMENT * ALIGNMENT) {}

    /// Return an array; null where it does not fit. work_bytes() of extraction.h says how much
    /// an image needs.
    template <class T>
    T *take(size_t count) {
        static_assert(std::is_trivially_destructible_v<T> && alignof(T) <= ALIGNMENT);
        const size_t size = padded<T>(count);
        if (size > bytes_ - used_) {
            return nullptr;
        }
        T *array = reinterpret_cast<T *>(begin_ + used_);
        used_ += size;
        most_ = used_ > most_ ? used_ : most_;
        return array;
    }

    /// Return an empty list of this capacity.
    template <class T>
    List<T> list(size_t capacity) {
        T *item = take<T>(capacity);
        return {item, 0, item == nullptr ? 0 : static_cast<int>(capacity), 0};
    }

    /// Bytes that were in use at a time at most.
    size_t most() const { return most_; }

    /// Bytes that an array takes.
    template <class T>
    static constexpr size_t padded(size_t count) {
        return (count * sizeof(T) + ALIGNMENT - 1) / ALIGNMENT * ALIGNMENT;
    }

    class Scope {
    public:
        explicit Scope(Arena &arena) : arena_(arena), used_(arena.used_) {}
        ~Scope() { arena_.used_ = used_; }
        Scope(const Scope &) = delete;
        Scope &operator=(const Scope &) = delete;

    private:
        Arena &arena_;
        size_t used_;
    };

private:
    std::byte *begin_ = nullptr;
    size_t bytes_ = 0, used_ = 0, most_ = 0;
};

}  // namespace st
