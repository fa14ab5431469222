// SPDX-License-Identifier: GPL-2.0
/*
 * An I2C adapter and an SPI controller whose transfers a program answers.
 *
 * /dev/answered: a read gives one transaction (the letter of the bus, the address or the SPI mode, how many bytes to read as
 * a low and a high byte, then the bytes sent), a write its answer: a 1 and the bytes that were read, or a 0 for an error.
 * A device is made by writing "name address" to the parameter i2c_device or "name" to spi_device, and removed by an empty
 * line.
 */
#include <linux/completion.h>
#include <linux/i2c.h>
#include <linux/miscdevice.h>
#include <linux/module.h>
#include <linux/mutex.h>
#include <linux/platform_device.h>
#include <linux/spi/spi.h>
#include <linux/uaccess.h>
#include <linux/wait.h>

enum { HEAD = 4, LONGEST = 512 };

static DEFINE_MUTEX(bus);
static DECLARE_WAIT_QUEUE_HEAD(waiting);
static DECLARE_COMPLETION(answer_came);
static u8 question[HEAD + LONGEST], answer[1 + LONGEST];
static size_t question_length, answer_length;
static struct platform_device *parent;
static struct spi_controller *spi_bus;
static struct spi_device *spi_part;
static struct i2c_client *i2c_part;

/* Returns 0 with the bytes that the program answers in `in`, or an error. */
static int ask(char letter, u8 address, const u8 *out, size_t length, u8 *in, size_t count)
{
	int error = 0;

	if (length > LONGEST || count > LONGEST)
		return -EMSGSIZE;
	mutex_lock(&bus);
	question[0] = letter;
	question[1] = address;
	question[2] = count & 0xFF;
	question[3] = count >> 8;
	memcpy(question + HEAD, out, length);
	reinit_completion(&answer_came);
	WRITE_ONCE(question_length, HEAD + length);
	wake_up(&waiting);
	if (!wait_for_completion_timeout(&answer_came, 120 * HZ))
		error = -ETIMEDOUT;
	else if (answer_length != 1 + count || !answer[0])
		error = -ENXIO;
	else
		memcpy(in, answer + 1, count);
	WRITE_ONCE(question_length, 0);
	mutex_unlock(&bus);
	return error;
}

static ssize_t give_question(struct file *file, char __user *to, size_t size, loff_t *at)
{
	size_t length;

	if (wait_event_interruptible(waiting, READ_ONCE(question_length)))
		return -ERESTARTSYS;
	length = question_length;
	WRITE_ONCE(question_length, 0);
	return size < length || copy_to_user(to, question, length) ? -EFAULT : length;
}

static ssize_t take_answer(struct file *file, const char __user *from, size_t size, loff_t *at)
{
	if (size > sizeof(answer) || copy_from_user(answer, from, size))
		return -EFAULT;
	answer_length = size;
	complete(&answer_came);
	return size;
}

static const struct file_operations operations = {
	.owner = THIS_MODULE,
	.read = give_question,
	.write = take_answer,
	.llseek = noop_llseek,
};
static struct miscdevice answered = { .minor = MISC_DYNAMIC_MINOR, .name = "answered", .fops = &operations };

static int transfer_i2c(struct i2c_adapter *adapter, struct i2c_msg *messages, int number)
{
	for (int n = 0; n < number; n++) {
		struct i2c_msg *one = messages + n, *next = n + 1 < number ? one + 1 : NULL;
		bool reads = one->flags & I2C_M_RD, turns = !reads && next && next->flags & I2C_M_RD;
		struct i2c_msg *in = reads ? one : turns ? next : NULL;
		int error = ask('i', one->addr, one->buf, reads ? 0 : one->len, in ? in->buf : NULL, in ? in->len : 0);

		if (error)
			return error;
		n += turns;
	}
	return number;
}

static u32 functions(struct i2c_adapter *adapter)
{
	return I2C_FUNC_I2C | (I2C_FUNC_SMBUS_EMUL & ~I2C_FUNC_SMBUS_QUICK);
}

static const struct i2c_algorithm algorithm = { .master_xfer = transfer_i2c, .functionality = functions };
static struct i2c_adapter i2c_bus = { .owner = THIS_MODULE, .algo = &algorithm, .name = "answered" };

/* What passes while chip select is low is one transaction. */
static int transfer_spi(struct spi_controller *controller, struct spi_message *message)
{
	static u8 frame[LONGEST], said[LONGEST];
	struct spi_transfer *one, *first = NULL;
	size_t length = 0;
	int error = 0;

	list_for_each_entry(one, &message->transfers, transfer_list) {
		first = first ?: one;
		if (length + one->len > LONGEST) {
			error = -EMSGSIZE;
			break;
		}
		if (one->tx_buf)
			memcpy(frame + length, one->tx_buf, one->len);
		else
			memset(frame + length, 0, one->len);
		length += one->len;
		message->actual_length += one->len;
		if (!one->cs_change && !list_is_last(&one->transfer_list, &message->transfers))
			continue;
		error = ask('s', message->spi->mode & (SPI_CPOL | SPI_CPHA), frame, length, said, length);
		if (error)
			break;
		for (length = 0;; first = list_next_entry(first, transfer_list)) {
			if (first->rx_buf)
				memcpy(first->rx_buf, said + length, first->len);
			length += first->len;
			if (first == one)
				break;
		}
		first = NULL;
		length = 0;
	}
	message->status = error;
	spi_finalize_current_message(controller);
	return error;
}

static int set_i2c_device(const char *text, const struct kernel_param *parameter)
{
	struct i2c_board_info info = {};
	unsigned int address;

	i2c_unregister_device(i2c_part);
	i2c_part = NULL;
	if (sscanf(text, "%19s %i", info.type, &address) < 2)
		return 0;
	info.addr = address;
	i2c_part = i2c_new_client_device(&i2c_bus, &info);
	return IS_ERR(i2c_part) ? PTR_ERR(xchg(&i2c_part, NULL)) : 0;
}

static int set_spi_device(const char *text, const struct kernel_param *parameter)
{
	struct spi_board_info info = { .max_speed_hz = 500000 };

	spi_unregister_device(spi_part);
	spi_part = NULL;
	if (sscanf(text, "%31s", info.modalias) < 1)
		return 0;
	spi_part = spi_new_device(spi_bus, &info);
	return spi_part ? 0 : -ENODEV;
}

static const struct kernel_param_ops i2c_device = { .set = set_i2c_device }, spi_device = { .set = set_spi_device };
module_param_cb(i2c_device, &i2c_device, NULL, 0200);
module_param_cb(spi_device, &spi_device, NULL, 0200);

static int __init begin(void)
{
	int error;

	parent = platform_device_register_simple("answered", -1, NULL, 0);
	if (IS_ERR(parent))
		return PTR_ERR(parent);
	spi_bus = spi_alloc_master(&parent->dev, 0);
	if (!spi_bus)
		return -ENOMEM;
	spi_bus->num_chipselect = 1;
	spi_bus->mode_bits = SPI_CPOL | SPI_CPHA;
	spi_bus->transfer_one_message = transfer_spi;
	i2c_bus.dev.parent = &parent->dev;
	error = misc_register(&answered);
	error = error ?: i2c_add_adapter(&i2c_bus);
	return error ?: spi_register_controller(spi_bus);
}
module_init(begin);

MODULE_DESCRIPTION("An I2C adapter and an SPI controller whose transfers a program answers");
MODULE_LICENSE("GPL");
